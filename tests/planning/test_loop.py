"""The loop around the core: order of events, actions and their failures, times, and the end."""

import logging
import select
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.host.process import Log, Notify
from hyperbit.controller.planning.core.events import (
    Abandon,
    AcceptanceEntry,
    Answered,
    Arrival,
    Disconnect,
    Event,
    Fail,
    FromExecutor,
    Identity,
    LinkDown,
    Publish,
    Published,
    PublishResult,
    Record,
    RecordCounts,
    Recorded,
    Reply,
    Request,
    SetpointArrived,
    Start,
    Tick,
    TipArrived,
    ToExecutor,
    Unsent,
    Wake,
    Warned,
)
from hyperbit.controller.planning.core.tasks import BuildTables, Done, Failed
from hyperbit.controller.planning.link import ExecutorLink, Inbox
from hyperbit.controller.planning.loop import LOOK_EVERY, STREAM_ENDS, STREAM_EVERY, WARNINGS_EVERY, Loop
from hyperbit.controller.program import Answer, Fault, Hello, Snapshot, Stop
from hyperbit.controller.refusals.reasons import Reason
from tests.planning.rig.executor import DIGEST, ScriptedExecutor
from tests.planning.rig.loop_parts import Remembering, ScriptedCore
from tests.waiting import PATIENCE

WALL = 1e9  # [UNIX s]
REQUEST = Request(Arrival(1, 100.0), "reset", None, WALL)
SETPOINT, TIP = SetpointArrived(b"s", Arrival(1, 0.0)), TipArrived(b"t", Arrival(1, 0.0))
TASK = BuildTables(1, b"")


class Bench:
    """A loop without a thread: the test calls its rounds, and sets its clock."""

    def __init__(self, path: Path) -> None:
        self.now = 100.0
        self.core, self.services, self.recorded = ScriptedCore(), Remembering(), list[Any]()
        self.inbox, self.link = Inbox(), ExecutorLink(path, "small", DIGEST, lambda: self.now)
        self.loop = self.make()

    def make(self) -> Loop:
        clocks = (lambda: self.now, lambda: WALL)
        return self.services.loop(self.core, self.inbox, self.link, self, clocks)

    def __call__(self, *step: Any) -> None:
        self.recorded.append(step)

    def flush(self) -> None:
        pass

    def ask(self, reply: Any) -> None:
        self.loop.request(self.loop.arrive(), "reset", None, reply)

    def handle(self, *events: Event) -> list[Event]:
        """Posts events, runs the loop once, and returns what the core has seen but snapshots."""
        before = len(self.core.steps)
        for event in events:
            self.inbox.post(event)
        self.loop.round()
        return [event for event in self.core.steps[before:] if "Snapshot" not in str(event)]

    def receive(self, *events: Event) -> list[Event]:
        """Does the same when the executor's message has arrived."""
        assert select.select([self.link.fileno()], [], [], PATIENCE)[0]
        return self.handle(*events)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path / "small.sock")
    bench.handle(Published(0))  # connects
    yield bench
    bench.loop.close()
    bench.link.close()


def test_posted_events_come_before_messages(executor: ScriptedExecutor, bench: Bench) -> None:
    executor.expect(Hello)
    while not any(isinstance(event, FromExecutor) for event in bench.core.steps):
        bench.receive()
    assert bench.link.send_now(Stop(1)) is None
    executor.expect(Stop)
    executor.send(Answer(1, "stopped"))
    assert bench.receive(REQUEST)[0] == REQUEST
    while not any(event == FromExecutor(Answer(1, "stopped")) for event in bench.core.steps):
        bench.receive()


def test_a_setpoint_that_waits_comes_before_a_request(bench: Bench) -> None:
    bench.loop.setpoints.put(*SETPOINT)
    assert bench.handle(Published(1), REQUEST) == [Published(1), SETPOINT, REQUEST]


def test_events_posted_by_the_core_s_actions_wait_for_the_next_round(bench: Bench) -> None:
    bench.core.script[Request] = [Start(1, TASK)]
    bench.services.broken = {"start"}
    assert bench.handle(REQUEST) == [REQUEST]
    assert bench.handle() == [Answered(1, Failed("RuntimeError('start is broken')"), True)]


def test_it_ticks_at_the_begin_and_at_the_last_wake(bench: Bench) -> None:
    assert bench.core.steps[-1] == Tick()
    bench.core.script[Request] = [Wake(101.0), Wake(102.0)]
    bench.handle(REQUEST)
    bench.now = 101.5
    assert bench.handle() == []
    bench.now = 102.0
    assert bench.handle() == [Tick()]
    bench.now = 200.0
    assert bench.handle(Published(1)) == [Published(1)]


def test_mailboxes_are_read_more_often_while_set_points_come(bench: Bench) -> None:
    loop = bench.loop
    loop.tips.put(*TIP)
    bench.now = loop.look_at
    assert bench.handle() == [TIP]
    assert loop.look_at == bench.now + LOOK_EVERY
    loop.setpoints.put(*SETPOINT)
    bench.now = loop.look_at
    assert bench.handle() == [SETPOINT]
    assert loop.look_at == bench.now + STREAM_EVERY
    bench.now += STREAM_ENDS
    bench.handle()
    assert loop.look_at == bench.now + LOOK_EVERY


def test_changed_warnings_are_told(bench: Bench) -> None:
    fault = Fault("clock-set", "system", "set by 1 s")
    bench.services.faults = (fault,)
    assert bench.handle(Published(1)) == [Published(1)]
    told = []
    for broken in (set(), set(), {"warnings"}, set()):
        bench.services.broken = broken
        bench.now += WARNINGS_EVERY
        told += bench.handle()
    bench.services.faults = ()
    bench.now += WARNINGS_EVERY
    told += bench.handle()
    assert [event for event in told if isinstance(event, Warned)] == [Warned((fault,)), Warned(())]


def test_actions_are_carried_out_in_order(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    result = PublishResult(1, Identity(1, 1), False, {"id": "a"})
    record = Record(1, Identity(1, 1), AcceptanceEntry("a", 0.0, 1), None)
    bench.core.script[Request] = [
        Start(1, TASK), Reply(1, {"accepted": True}), Publish("state", {"mode": "ready"}), result, record,
        RecordCounts((1, 2)), ToExecutor(Stop(1)), Abandon(1), Notify("WATCHDOG=1"),
        Log(logging.WARNING, "100 % moved", {"HYPERBIT_GOAL": "a"}), Wake(0.0),
    ]  # fmt: skip
    bench.ask(lambda payload: bench.services.calls.append(("reply", payload)))
    assert bench.handle()[:2] == [REQUEST, Tick()]
    assert bench.services.calls == [
        ("start", 1, TASK), ("reply", {"accepted": True}), ("publish", "state", {"mode": "ready"}),
        ("publish_result", result), ("record", record), ("counts", (1, 2)), ("abandon", 1), ("notify", "WATCHDOG=1"),
    ]  # fmt: skip
    (line,) = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert (line.getMessage(), line.journal) == ("100 % moved", {"HYPERBIT_GOAL": "a"})  # type: ignore[attr-defined]


def test_messages_go_to_the_executor_until_it_is_disconnected(executor: ScriptedExecutor, bench: Bench) -> None:
    bench.core.script[FromExecutor] = lambda event: (
        [ToExecutor(Stop(5)), Disconnect("the executor is silent")] if isinstance(event.message, Snapshot) else []
    )
    while not bench.link.received:
        bench.receive()
    executor.expect(Hello)
    assert executor.expect(Stop).request == 5
    assert LinkDown("the executor is silent") in bench.handle()


def test_a_failing_action_stops_no_other(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    def fail(payload: Any) -> None:
        raise RuntimeError("the query has gone")

    bench.core.script[Request] = lambda event: [Reply(event.number, {}), Publish("state", {}), Reply(event.number, 0)]
    bench.services.broken = {"publish"}
    answered: list[Any] = []
    bench.ask(fail)
    bench.ask(answered.append)
    bench.handle()
    assert answered == [{}], "a request is answered at most once"
    assert [record.getMessage() for record in caplog.records].count("the action Reply failed") == 1
    assert [call[0] for call in bench.services.calls] == ["publish", "publish"]


def test_the_recorder_gets_each_step_until_it_fails(bench: Bench) -> None:
    def fail(*step: Any) -> None:
        failed.append(step)
        raise OSError("the disk is full")

    failed: list[Any] = []

    bench.core.script[Request] = [Notify("a")]
    bench.recorded.clear()
    bench.handle(REQUEST)
    assert bench.recorded == [(REQUEST, 100.0, WALL, [Notify("a")])]
    bench.loop.recorder = fail
    bench.handle(REQUEST, REQUEST)
    assert len(failed) == 1
    assert len(bench.services.calls) == 3


def run(bench: Bench) -> None:
    bench.loop.start()
    assert bench.loop.ended.wait(PATIENCE)


def test_an_exception_of_the_core_ends_the_process(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    def fail(event: Request) -> list[Any]:
        raise KeyError(event.number)

    bench.core.script[Request] = fail
    bench.inbox.post(REQUEST)
    bench.inbox.post(Unsent(1, "it is not handled any more"))
    run(bench)
    assert bench.services.calls == [("fatal", "the planner failed: KeyError(1)")]
    assert "Traceback" in caplog.text
    assert bench.core.steps[-1] == REQUEST
    assert bench.recorded[-1] == (REQUEST, 100.0, WALL, None)


def test_the_core_can_end_the_process(bench: Bench) -> None:
    bench.core.script[Recorded] = [Fail("the worker for goals does not answer"), Notify("WATCHDOG=1")]
    bench.inbox.post(Recorded(1))
    run(bench)
    assert bench.services.calls == [("fatal", "the worker for goals does not answer")]


def test_closing_refuses_what_was_not_answered(bench: Bench) -> None:
    answered: list[Any] = []
    bench.ask(answered.append)
    bench.loop.close()
    bench.loop.close()
    assert [answer.message for answer in answered] == [Reason.SHUTTING_DOWN.sentence]


def test_no_event_is_missed(bench: Bench) -> None:
    count, senders = 2_000, 3

    def post(sender: int) -> None:
        for k in range(count):
            bench.inbox.post(Answered(sender * count + k, Done(), True))

    bench.loop = bench.make()
    bench.loop.warnings_at = bench.link.retry_at = 1e5  # nothing is due: only wake-ups end the waiting
    bench.loop.start()
    threads = [threading.Thread(target=post, args=(k,)) for k in range(senders)]
    for thread in threads:
        thread.start()
    got = [bench.core.expect(Answered).task for _ in range(senders * count)]
    assert sorted(got) == list(range(senders * count))
    for sender in range(senders):
        assert [task for task in got if task // count == sender] == sorted(t for t in got if t // count == sender)
