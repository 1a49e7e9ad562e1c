"""The outbox: order of messages, and behaviour while peers read nothing."""

import json
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from controller.gateway.encoding import encode
from controller.gateway.outbox import MOST_WAITING, RECONNECTED, Outbox
from tests.waiting import PATIENCE, eventually


class FakeSession:
    """A session whose peers read nothing while `taking` is not set."""

    def __init__(self) -> None:
        self.taking = threading.Event()
        self.taking.set()
        self.waiting = threading.Event()
        self.sent: list[tuple[str, Any]] = []

    def declare_publisher(self, key: str, **_: Any) -> "FakePublisher":
        return FakePublisher(self, key)

    def send(self, key: str, data: bytes) -> None:
        self.waiting.set()
        assert self.taking.wait(PATIENCE)
        self.sent.append((key, json.loads(data)))


class FakePublisher:
    def __init__(self, session: FakeSession, key: str) -> None:
        self.session, self.key = session, key

    def put(self, data: bytes) -> None:
        self.session.send(self.key, data)


class FakeQuery:
    def __init__(self, session: FakeSession) -> None:
        self.session, self.ended = session, 0

    def __enter__(self) -> "FakeQuery":
        return self

    def __exit__(self, *_: object) -> None:
        self.ended += 1

    def reply(self, key: str, data: bytes, encoding: object) -> None:
        self.session.send(key, data)


@pytest.fixture
def session() -> Iterator[FakeSession]:
    session = FakeSession()
    yield session
    session.taking.set()


def stall(session: FakeSession, outbox: Outbox) -> None:
    session.taking.clear()
    outbox.publish("feedback", {})
    assert session.waiting.wait(PATIENCE)


def test_result_of_the_planner_before_waits_for_clients_to_connect_and_delays_nothing(session: FakeSession) -> None:
    now = 100.0
    outbox = Outbox(session, "p", clock=lambda: now)
    outbox.publish("inherited", {"n": 1, "status": "aborted"})
    outbox.publish("result", {"n": 2, "status": "succeeded"})
    eventually(lambda: session.sent)
    assert (session.sent, outbox.waiting()) == ([("p/result", {"n": 2, "status": "succeeded"})], 1)
    now += RECONNECTED
    eventually(lambda: len(session.sent) == 2)
    assert session.sent[1] == ("p/result", {"n": 1, "status": "aborted"})
    outbox.close(PATIENCE)


def test_answer_feedback_and_result_of_a_goal_leave_in_order(session: FakeSession) -> None:
    outbox, query = Outbox(session, "p"), FakeQuery(session)
    stall(session, outbox)
    outbox.answer(query, "goal")({"accepted": True})
    outbox.publish("feedback", {"n": 1})
    outbox.publish("result", {"n": 2, "status": "succeeded"})
    session.taking.set()
    outbox.close(PATIENCE)
    assert session.sent[1:] == [
        ("p/goal", {"accepted": True}),
        ("p/feedback", {"n": 1}),
        ("p/result", {"n": 2, "status": "succeeded"}),
    ]
    assert query.ended == 1


def test_a_result_overtakes_refusals_and_other_answers(session: FakeSession) -> None:
    outbox = Outbox(session, "p")
    stall(session, outbox)
    outbox.answer(FakeQuery(session), "goal")({"accepted": False})
    outbox.answer(FakeQuery(session), "plan")({"accepted": True})
    outbox.answer(FakeQuery(session), "arm")({"name": "a"})
    outbox.publish("result", {"status": "refused"})
    outbox.publish("result", {"status": "succeeded"})
    outbox.answer(FakeQuery(session), "stop")({"accepted": True})
    session.taking.set()
    outbox.close(PATIENCE)
    assert [key for key, _ in session.sent[1:]] == ["p/result", "p/stop", "p/goal", "p/plan", "p/arm", "p/result"]


def test_while_peers_take_nothing_only_results_pile_up(session: FakeSession) -> None:
    outbox = Outbox(session, "p")
    stall(session, outbox)
    for _ in range(2 * MOST_WAITING):
        outbox.answer(FakeQuery(session), "arm")({})
        outbox.publish("result", {"status": "refused"})
        outbox.publish("feedback", {})
    assert outbox.waiting() == 2 * MOST_WAITING
    outbox.publish("result", {"status": "succeeded"})
    assert outbox.waiting() == 2 * MOST_WAITING + 1
    session.taking.set()
    outbox.close(PATIENCE)
    assert ("p/result", {"status": "succeeded"}) in session.sent


@pytest.mark.parametrize("value", [object(), "\udc80", {1: object()}])
def test_a_payload_without_json_is_still_answered(session: FakeSession, value: object) -> None:
    outbox, query = Outbox(session, "p"), FakeQuery(session)
    outbox.answer(query, "plan")({"value": value})
    outbox.answer(query, "plan")({"value": 1})
    outbox.close(PATIENCE)
    assert session.sent[0][1]["message"] == "internal error, see the journal"
    assert session.sent[1] == ("p/plan", {"value": 1})
    assert query.ended == 2


@pytest.mark.parametrize(("goal", "told"), [("a", "a"), ("\udc80", "\\udc80")])
def test_a_result_without_json_still_names_its_goal_and_status(session: FakeSession, goal: str, told: str) -> None:
    outbox = Outbox(session, "p")
    outbox.publish("result", {"id": goal, "status": "aborted", "code": -4, "value": object()})
    outbox.close(PATIENCE)
    ((_, result),) = session.sent
    assert (result["id"], result["status"], result["message"]) == (told, "aborted", "internal error, see the journal")


def test_a_peer_that_is_gone_ends_nothing(session: FakeSession) -> None:
    outbox, query = Outbox(session, "p"), FakeQuery(session)
    query.reply = lambda *_, **__: 1 / 0  # type: ignore[method-assign]
    outbox.answer(query, "goal")({})
    outbox.publish("feedback", {})
    outbox.close(PATIENCE)
    assert session.sent == [("p/feedback", {})]


def test_numpy_is_written_as_numbers_and_nan_as_null() -> None:
    payload = {
        "a": np.float64(1.5), "b": np.uint8(3), "c": np.array([1, 2]), "d": float("nan"), "e": np.float64("inf"),
        "f": np.array([np.nan]), "g": np.bool_(True),
    }  # fmt: skip
    expected = {"a": 1.5, "b": 3, "c": [1, 2], "d": None, "e": None, "f": [None], "g": True}
    assert json.loads(encode(payload)) == expected


def test_after_a_standstill_results_wait_for_peers_and_answers_do_not(session: FakeSession) -> None:
    now = [100.0]
    outbox = Outbox(session, "hyperbit/arm", lease=2.0, clock=lambda: now[0])  # type: ignore[arg-type]
    now[0] += 1.1  # as after SIGSTOP and SIGCONT
    eventually(lambda: outbox._wait_until > now[0])
    outbox.publish("result", {"id": "a", "status": "succeeded"})
    outbox.publish("feedback", {"id": "b"})
    outbox.answer(FakeQuery(session), "arm")({"name": "arm"})  # type: ignore[arg-type]
    eventually(lambda: session.sent)
    assert session.sent == [("hyperbit/arm/arm", {"name": "arm"})]
    for _ in range(int(RECONNECTED / 0.9) + 1):
        turned = now[0] = now[0] + 0.9
        eventually(lambda turned=turned: outbox._last_reading == turned)
    eventually(lambda: len(session.sent) == 3)
    assert [payload["id"] for _, payload in session.sent[1:]] == ["a", "b"]
    outbox.close()


def test_at_the_end_results_wait_no_longer(session: FakeSession) -> None:
    now = [100.0]
    outbox = Outbox(session, "hyperbit/arm", lease=2.0, clock=lambda: now[0])  # type: ignore[arg-type]
    now[0] += 10.0
    eventually(lambda: outbox._wait_until > now[0])
    outbox.publish("result", {"id": "a", "status": "succeeded"})
    outbox.close(PATIENCE)
    assert [payload["id"] for _, payload in session.sent] == ["a"]
