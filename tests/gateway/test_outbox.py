"""The outbox: order of messages, and behaviour while peers read nothing."""

import json
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.gateway.outbox import MOST_WAITING, POLL, RECONNECTED, SENT_WITHIN, Outbox, encoded
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.goals import Feedback, GoalEnd, Note, Result, done, refused
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.planning.core.events import Identity, Published, PublishResult
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
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

    def on(self, key: str) -> list[Any]:
        return [payload for name, payload in self.sent if name == f"p/{key}"]

    def send(self, key: str, data: bytes) -> None:
        self.waiting.set()
        assert self.taking.wait(PATIENCE)
        self.sent.append((key, json.loads(data)))


class FakePublisher:
    def __init__(self, session: FakeSession, key: str) -> None:
        self.session, self.key = session, key

    def put(self, data: bytes) -> None:
        self.session.send(self.key, data)


class Results:
    """What an outbox tells of results, in order, with the number of messages that were sent before.

    Attributes:
        told: goals that ended, programs that were noted, and numbers that were posted.
        fatal: messages of a thread that died.
    """

    def __init__(self, session: FakeSession) -> None:
        self.session, self.told, self.fatal, self.fail = session, list[tuple[Any, int]](), list[str](), False

    def tell(self, what: Any) -> None:
        self.told.append((what, len(self.session.sent)))

    def note(self, identity: Identity, payload: Result) -> None:
        if self.fail:
            raise RuntimeError("a defect")
        self.tell((identity, payload.status))

    def outbox(self, **named: Any) -> Outbox:
        outbox = Outbox(self.session, "p", self.tell, self.note, self.tell, self.fatal.append, **named)  # type: ignore[arg-type]
        outbox.start()
        return outbox


def result(goal: str = "a", status: str = "succeeded", inherited: bool = False, **fields: Any) -> PublishResult:
    return PublishResult(7, Identity(1, 2), inherited, Result(id=goal, status=status, **fields))


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


@pytest.fixture
def results(session: FakeSession) -> Results:
    return Results(session)


def stall(session: FakeSession, outbox: Outbox) -> None:
    session.taking.clear()
    outbox.publish("feedback", Feedback())
    assert session.waiting.wait(PATIENCE)


def test_a_result_is_marked_then_published_then_posted(session: FakeSession, results: Results) -> None:
    outbox = results.outbox()
    outbox.publish_result(result("a", error=np.float64("nan")))
    outbox.close(PATIENCE)
    ((key, sent),) = session.sent
    assert (key, sent["id"], sent["status"], sent["error"]) == ("p/result", "a", "succeeded", None)
    assert results.told == [("a", 0), ((Identity(1, 2), "succeeded"), 0), (Published(7), 1)]


def test_a_result_counts_as_published_when_it_has_left_the_process(session: FakeSession, results: Results) -> None:
    now = 100.0
    outbox = results.outbox(clock=lambda: now)
    outbox.publish_result(result("a"))
    eventually(lambda: len(results.told) == 2)
    outbox.publish("feedback", Feedback())
    eventually(lambda: len(session.sent) == 2)
    assert len(results.told) == 2
    now += SENT_WITHIN
    eventually(lambda: results.told[2:] == [(Published(7), 2)])
    outbox.close(PATIENCE)


def test_the_thread_looks_again_when_a_result_has_left_the_process(session: FakeSession, results: Results) -> None:
    now = 0.0
    hooks = results.tell, results.note, results.tell
    outbox = Outbox(session, "p", *hooks, results.fatal.append, clock=lambda: now)  # type: ignore[arg-type]
    outbox.publish_result(result("a"))
    assert [outbox.step(), outbox.step()] == [0.0, SENT_WITHIN]
    now = SENT_WITHIN
    assert outbox.step() == POLL
    assert results.told[2:] == [(Published(7), 1)]


def test_a_standstill_is_told_with_its_length(
    session: FakeSession, results: Results, caplog: pytest.LogCaptureFixture
) -> None:
    now = 100.0
    hooks = results.tell, results.note, results.tell
    outbox = Outbox(session, "p", *hooks, results.fatal.append, lease=2.0, clock=lambda: now)  # type: ignore[arg-type]
    now += 1.5
    outbox.step()
    outbox.step()
    assert caplog.messages == ["the process stood still for 1.5 s: results wait for 5 s"]


def test_a_result_that_was_not_sent_does_not_count_as_published(session: FakeSession, results: Results) -> None:
    outbox = results.outbox()
    outbox.publishers["result"].put = lambda data: 1 / 0  # type: ignore[method-assign]
    outbox.publish_result(result())
    outbox.publish("feedback", Feedback(id="a", stages=1))
    outbox.close(PATIENCE)
    marked = [("a", 0), ((Identity(1, 2), "succeeded"), 0)]
    assert ([key for key, _ in session.sent], results.told, results.fatal) == (["p/feedback"], marked, [])


def test_a_thread_that_dies_says_so(session: FakeSession, results: Results) -> None:
    outbox, results.fail = results.outbox(), True
    outbox.publish_result(result())
    (message,) = eventually(lambda: results.fatal)
    assert "a defect" in message


def test_result_of_the_planner_before_waits_for_clients_to_connect_and_delays_nothing(
    session: FakeSession, results: Results
) -> None:
    now = 100.0
    outbox = results.outbox(clock=lambda: now)
    outbox.publish_result(result("1", "aborted", inherited=True))
    outbox.publish_result(result("2"))
    eventually(lambda: session.sent)
    assert ([it["id"] for it in session.on("result")], outbox.waiting()) == (["2"], 1)
    now += RECONNECTED
    eventually(lambda: len(session.sent) == 2)
    assert [it["id"] for it in session.on("result")] == ["2", "1"]
    outbox.close(PATIENCE)


def test_answer_feedback_and_result_of_a_goal_leave_in_order(session: FakeSession, results: Results) -> None:
    outbox, query = results.outbox(), FakeQuery(session)
    stall(session, outbox)
    outbox.answer(query, "goal", done("accepted"))
    outbox.publish("feedback", Feedback(id="a", stages=1))
    outbox.publish_result(result())
    session.taking.set()
    outbox.close(PATIENCE)
    assert [key for key, _ in session.sent[1:]] == ["p/goal", "p/feedback", "p/result"]
    assert query.ended == 1


def test_a_result_overtakes_states_refusals_and_other_answers(session: FakeSession, results: Results) -> None:
    outbox = results.outbox()
    stall(session, outbox)
    outbox.answer(FakeQuery(session), "goal", refused(Refusal(Reason.BUSY)))
    outbox.answer(FakeQuery(session), "plan", done("planned"))
    outbox.answer(FakeQuery(session), "arm", Description(name="a"))
    outbox.publish("result", GoalEnd(status="refused"))
    outbox.publish("state", State(mode="ready"))
    outbox.publish_result(result())
    outbox.answer(FakeQuery(session), "stop", done("stopped"))
    session.taking.set()
    outbox.close(PATIENCE)
    keys = ["p/result", "p/stop", "p/state", "p/goal", "p/plan", "p/arm", "p/result"]
    assert [key for key, _ in session.sent[1:]] == keys


def test_for_a_slow_peer_only_the_latest_state_and_diagnostics_wait(session: FakeSession, results: Results) -> None:
    outbox = results.outbox()
    stall(session, outbox)
    for k in range(100):
        outbox.publish("state", State(mode="ready", obstacles=k))
        outbox.publish("diagnostics", Diagnostics(dropped=k, queues={"planning": 2}))
        outbox.publish("@request", Note(key="stop", answer=done("")))
    session.taking.set()
    outbox.close(PATIENCE)
    assert [(it["obstacles"], it["poses"]) for it in session.on("state")] == [(99, 0)]
    (diagnostics,) = session.on("diagnostics")
    assert (diagnostics["dropped"], diagnostics["queues"]) == (99, {"planning": 2, "outbox": 100})


def test_the_last_state_is_published_at_the_end(session: FakeSession, results: Results) -> None:
    outbox = results.outbox()
    for k in range(10):
        outbox.publish("state", State(mode="ready", obstacles=k))
    outbox.close(PATIENCE)
    assert session.on("state")[-1]["obstacles"] == 9


def test_while_peers_take_nothing_only_results_pile_up(session: FakeSession, results: Results) -> None:
    outbox = results.outbox()
    stall(session, outbox)
    for _ in range(2 * MOST_WAITING):
        outbox.answer(FakeQuery(session), "arm", Description())
        outbox.publish("result", GoalEnd(status="refused"))
        outbox.publish("feedback", Feedback())
    assert outbox.waiting() == 2 * MOST_WAITING
    outbox.publish_result(result())
    assert outbox.waiting() == 2 * MOST_WAITING + 1
    session.taking.set()
    outbox.close(PATIENCE)
    assert "a" in [sent.get("id") for sent in session.on("result")]


def test_messages_of_many_threads_are_all_sent(session: FakeSession, results: Results) -> None:
    outbox, number = results.outbox(), MOST_WAITING // 5
    queue = [
        threading.Thread(
            target=lambda: [outbox.publish("@request", Note(key="stop", answer=done(""))) for _ in range(number)]
        )
        for _ in range(4)
    ]
    for thread in queue:
        thread.start()
    for thread in queue:
        thread.join()
    outbox.close(PATIENCE)
    assert len(session.on("@request")) == 4 * number


@pytest.mark.parametrize("value", [object(), "\udc80", {1: object()}])
def test_a_payload_without_json_is_still_answered(session: FakeSession, results: Results, value: object) -> None:
    outbox, query = results.outbox(), FakeQuery(session)
    outbox.answer(query, "plan", done(value))  # type: ignore[arg-type]
    outbox.answer(query, "plan", done("planned"))
    outbox.close(PATIENCE)
    assert session.sent[0][1]["message"] == "internal error, see the journal"
    assert session.sent[1][1]["message"] == "planned"
    assert query.ended == 2


@pytest.mark.parametrize(("goal", "told"), [("a", "a"), ("\udc80", "\\udc80")])
def test_a_result_without_json_still_names_its_goal_and_status(
    session: FakeSession, results: Results, goal: str, told: str
) -> None:
    outbox = results.outbox()
    outbox.publish_result(result(goal, "aborted", code=-4, error=object()))
    outbox.close(PATIENCE)
    ((_, sent),) = session.sent
    assert (sent["id"], sent["status"], sent["message"]) == (told, "aborted", "internal error, see the journal")
    assert results.told[-1] == (Published(7), 1)


def test_a_peer_that_is_gone_ends_nothing(session: FakeSession, results: Results) -> None:
    outbox, query = results.outbox(), FakeQuery(session)
    query.reply = lambda *_, **__: 1 / 0  # type: ignore[method-assign]
    outbox.answer(query, "goal", done(""))
    outbox.publish("feedback", Feedback())
    outbox.close(PATIENCE)
    assert [key for key, _ in session.sent] == ["p/feedback"]


def test_numpy_is_written_as_numbers_and_nan_as_null() -> None:
    given = [
        np.float64(1.5),
        np.uint8(3),
        np.array([1, 2]),
        float("nan"),
        np.float64("inf"),
        np.array([np.nan]),
        np.bool_(True),
    ]
    sent = json.loads(encoded(Feedback(bias=given)))  # type: ignore[arg-type]
    assert sent["bias"] == [1.5, 3, [1, 2], None, None, [None], True]


def test_after_a_standstill_results_wait_for_peers_and_others_do_not(session: FakeSession, results: Results) -> None:
    now = [100.0]
    outbox = results.outbox(lease=2.0, clock=lambda: now[0])
    now[0] += 1.1  # as after SIGSTOP and SIGCONT
    eventually(lambda: outbox.wait_until > now[0])
    outbox.publish_result(result())
    outbox.publish_result(result("of the planner before", inherited=True))
    outbox.publish("feedback", Feedback(id="b"))
    outbox.publish("state", State(mode="ready"))
    eventually(lambda: session.sent)
    outbox.answer(FakeQuery(session), "arm", Description(name="arm"))
    eventually(lambda: len(session.sent) == 2)
    assert [key for key, _ in session.sent] == ["p/state", "p/arm"]
    assert session.sent[0][1]["poses"] == 0
    for _ in range(int(RECONNECTED / 0.9) + 1):
        turned = now[0] = now[0] + 0.9
        eventually(lambda turned=turned: outbox.last_reading == turned)
    eventually(lambda: len(session.sent) == 5)
    assert {payload["id"] for _, payload in session.sent[2:]} == {"a", "b", "of the planner before"}
    outbox.close()


def test_at_the_end_results_wait_no_longer(session: FakeSession, results: Results) -> None:
    now = [100.0]
    outbox = results.outbox(lease=2.0, clock=lambda: now[0])
    now[0] += 10.0
    eventually(lambda: outbox.wait_until > now[0])
    outbox.publish_result(result())
    outbox.close(PATIENCE)
    assert [payload["id"] for _, payload in session.sent] == ["a"]
