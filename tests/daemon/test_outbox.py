"""What leaves the daemon when peers do not take it, and when it has no JSON."""

import json
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from controller.daemon.messages import encode
from controller.daemon.outbox import MOST_WAITING, Outbox
from controller.daemon.state import Snapshot
from controller.daemon.telemetry import Publisher
from controller.manipulator.held import free
from tests.daemon.rig import ARM
from tests.daemon.waiting import PATIENCE, eventually


class FakeSession:
    """A session whose peers take nothing while `taking` is not set."""

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


def test_all_leaves_in_order(session: FakeSession) -> None:
    outbox, query = Outbox(session, "p"), FakeQuery(session)
    outbox.publish("feedback", {"n": 1})
    outbox.answer(query, "goal")({"n": 2})
    outbox.publish("result", {"n": 3, "status": "succeeded"})
    outbox.close()
    assert session.sent == [
        ("p/feedback", {"n": 1}),
        ("p/goal", {"n": 2}),
        ("p/result", {"n": 3, "status": "succeeded"}),
    ]
    assert query.ended == 1


def test_while_peers_take_nothing_only_results_pile_up(session: FakeSession) -> None:
    outbox = Outbox(session, "p")
    stall(session, outbox)
    for _ in range(2 * MOST_WAITING):
        outbox.answer(FakeQuery(session), "arm")({})
        outbox.publish("result", {"status": "refused"})
        outbox.publish("feedback", {})
    assert outbox.waiting() == MOST_WAITING
    outbox.publish("result", {"status": "succeeded"})
    assert outbox.waiting() == MOST_WAITING + 1
    session.taking.set()
    outbox.close(PATIENCE)
    assert session.sent[-1] == ("p/result", {"status": "succeeded"})


@pytest.mark.parametrize("value", [object(), "\udc80", {1: object()}])
def test_what_has_no_json_is_still_answered(session: FakeSession, value: object) -> None:
    outbox, query = Outbox(session, "p"), FakeQuery(session)
    outbox.answer(query, "plan")({"value": value})
    outbox.answer(query, "plan")({"value": 1})
    outbox.close(PATIENCE)
    assert session.sent[0][1]["message"] == "internal error, see the journal"
    assert session.sent[1] == ("p/plan", {"value": 1})
    assert query.ended == 2


def test_a_peer_that_is_gone_ends_nothing(session: FakeSession) -> None:
    outbox, query = Outbox(session, "p"), FakeQuery(session)
    query.reply = lambda *_, **__: 1 / 0  # type: ignore[method-assign]
    outbox.answer(query, "goal")({})
    outbox.publish("feedback", {})
    outbox.close(PATIENCE)
    assert session.sent == [("p/feedback", {})]


def test_numpy_is_written_as_numbers_and_nothing_as_nan() -> None:
    payload = {
        "a": np.float64(1.5), "b": np.uint8(3), "c": np.array([1, 2]), "d": float("nan"), "e": np.float64("inf"),
        "f": np.array([np.nan]), "g": np.bool_(True),
    }  # fmt: skip
    expected = {"a": 1.5, "b": 3, "c": [1, 2], "d": None, "e": None, "f": [None], "g": True}
    assert json.loads(encode(payload)) == expected


def snapshot(reason: str) -> Snapshot:
    return Snapshot(1.0, "ready", reason, None, np.full(len(ARM.actuators), -1, np.int8), None, None, (), free(ARM))


def test_for_a_slow_peer_only_the_latest_state_waits(session: FakeSession) -> None:
    publisher = Publisher(session, "p", ARM, lambda: 0, lambda: 0, dict, str)
    session.taking.clear()
    publisher.show(snapshot("first"))
    assert session.waiting.wait(PATIENCE)
    for k in range(1000):
        publisher.show(snapshot(str(k)))
    session.taking.set()
    publisher.close(PATIENCE)
    assert [payload["reason"] for _, payload in session.sent] == ["first", "999"]


def test_telemetry_survives_what_cannot_be_sent(session: FakeSession) -> None:
    publisher = Publisher(session, "p", ARM, lambda: 0, lambda: 0, dict, str)
    publisher.show(snapshot("\udc80"))
    eventually(lambda: publisher._latest is None)
    publisher.show(snapshot("next"))
    publisher.close(PATIENCE)
    assert [payload["reason"] for _, payload in session.sent] == ["next"]
