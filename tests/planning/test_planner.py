"""The planner as the gateway uses it: requests, the way of a stop, mailboxes, and the end."""

import queue
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec import to_builtins

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.process import Quit
from hyperbit.controller.planning.core.events import (
    CancelMessage,
    FromExecutor,
    Key,
    LinkDown,
    Message,
    Reply,
    Request,
    ToExecutor,
    Unsent,
)
from hyperbit.controller.planning.core.requests import CANCELED
from hyperbit.controller.planning.link import ExecutorLink, Inbox
from hyperbit.controller.planning.planner import Planner
from hyperbit.controller.program import Acknowledge, Cancel, Hello, Stop, Welcome
from hyperbit.controller.workspace.densities import Densities
from tests.planning.rig.executor import DIGEST, ScriptedExecutor
from tests.planning.rig.loop_parts import Remembering, ScriptedCore
from tests.waiting import PATIENCE


class Bench:
    def __init__(self, arm: Arm, densities: Densities, path: Path) -> None:
        self.core, self.services, inbox = ScriptedCore(), Remembering(), Inbox()
        link = ExecutorLink(path, "small", DIGEST)
        self.core.script[Request] = lambda event: [Reply(event.number, {"number": event.number})]
        self.planner = Planner(arm, densities, self.services.loop(self.core, inbox, link))
        self.replies: queue.Queue[Any] = queue.Queue()

    def request(self, key: Key, message: Message) -> Request:
        """Sends a request, waits for its reply, and returns the event."""
        self.planner.loop.request(self.planner.loop.arrive(), key, message, self.replies.put)
        event = self.core.expect(Request)
        assert self.replies.get(timeout=PATIENCE) == {"number": event.number}
        return event

    def welcome(self) -> None:
        while not isinstance(self.core.expect(FromExecutor).message, Welcome):
            pass

    def end_in_order(self) -> None:
        """Ends goals and the loop, as `planning` does."""
        self.planner.loop.end_goals()
        self.planner.loop.close()

    def end(self, event: Quit) -> list[Any]:
        self.core.ended = True
        return [ToExecutor(Acknowledge(7))]


@pytest.fixture
def bench(small: Arm, small_densities: Densities, tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(small, small_densities, tmp_path / "small.sock")
    bench.core.script[Quit] = bench.end
    bench.planner.loop.start()
    yield bench
    bench.end_in_order()


def test_stop_and_cancel_go_to_the_executor_at_once(executor: ScriptedExecutor, bench: Bench) -> None:
    bench.welcome()
    executor.expect(Hello)
    bench.request("cancel", CancelMessage("a"))
    bench.request("stop", None)
    bench.request("cancel", CancelMessage())
    assert executor.expect(Stop) == Stop(2)
    assert executor.expect(Cancel) == Cancel(3, None, CANCELED)
    assert executor.nothing(object)


def test_a_stop_that_cannot_be_sent_is_told_after_its_request(bench: Bench) -> None:
    reason = bench.core.expect(LinkDown).reason
    stop = bench.request("stop", None)
    assert bench.core.expect(Unsent) == Unsent(stop.number, reason)
    cancel = bench.request("cancel", CancelMessage())
    assert bench.core.expect(Unsent) == Unsent(cancel.number, reason)


def test_the_description_has_the_wanted_parts(bench: Bench) -> None:
    assert bench.planner.description().name == "small"
    parts = ("drawing", "file", "density")
    without, whole = (set(to_builtins(bench.planner.description(wanted))) for wanted in ((), parts))
    assert whole - without == set(parts)


def test_goals_end_before_the_connection(executor: ScriptedExecutor, bench: Bench) -> None:
    bench.welcome()
    executor.expect(Hello)
    bench.planner.loop.end_goals()
    assert bench.core.expect(Quit) == Quit()
    assert executor.expect(Acknowledge).result == 7
    bench.end_in_order()
    assert bench.services.calls == []


def test_an_end_without_a_start_does_not_wait(small: Arm, small_densities: Densities, tmp_path: Path) -> None:
    bench = Bench(small, small_densities, tmp_path / "small.sock")
    bench.end_in_order()
    assert bench.core.steps == []
