"""The end of a stream of set-points: by a cancel, goal, mode, lost executor or failed search."""

from __future__ import annotations

import logging
import math

import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.process import Log
from hyperbit.controller.planning.core.events import Abandon
from hyperbit.controller.planning.core.stream import POLL
from hyperbit.controller.planning.core.tasks import Failed
from hyperbit.controller.program import Setpoint
from tests.planning.core.stream_bench import A, StreamBench


@pytest.fixture
def bench(small: Arm) -> StreamBench:
    return StreamBench(small)


def test_without_a_stream_there_is_nothing_to_withdraw_or_to_wait_for(bench: StreamBench) -> None:
    bench.stream.park()
    bench.step()
    assert (bench.actions, bench.stream.due) == ([], math.inf)


def test_a_cancel_ends_the_stream_until_it_pauses(bench: StreamBench) -> None:
    number, _ = bench.search()
    (first,) = bench.take(Setpoint)
    bench.admission.bar(1_000)
    bench.run(0.1)
    assert bench.take(Abandon) == [Abandon(number)]
    bench.admission.answered(1_000)
    bench.numbers = 1_000
    bench.show(epoch=2)
    bench.found(number, (bench.states(*A),))
    bench.run(1.0)
    assert not bench.take(Setpoint)
    assert (bench.status()["streams"], bench.status()["alive"]) == (1, False)
    assert bench.status()["received"] >= 50
    bench.position = None
    bench.run(2 * bench.timeout)
    assert bench.status()["rate"] == 0
    bench.position = bench.tip(*A)
    bench.run(POLL)
    command = bench.take(Setpoint)[0]
    assert (command.stream > first.stream, command.epoch) == (True, 2)
    assert bench.status()["streams"] == 2


def test_a_stream_belongs_to_its_sender_until_it_pauses(bench: StreamBench) -> None:
    here, there = {"position": bench.tip(*A)}, {"position": bench.tip(0, 0, 0, 0)}
    for _ in range(5):
        bench.put(here, "left")
        bench.put(there, "right")
        bench.advance(bench.timeout / 2)
    assert (bench.status()["sender"], bench.status()["refused"], bench.status()["streams"]) == ("left", 5, 1)
    assert '"right": "left" streams set-points already' in bench.status()["last_refusal"]
    bench.advance(bench.timeout)
    assert bench.status()["sender"] is None
    bench.put(there, "right")
    bench.put(here)
    assert (bench.status()["sender"], bench.status()["streams"]) == ("right", 2)
    assert "a client without a name" in bench.status()["last_refusal"]


def test_a_cancel_bars_also_the_stream_of_a_sender_that_waits_for_its_turn(bench: StreamBench) -> None:
    here, there = {"position": bench.tip(*A)}, {"position": bench.tip(0, 0, 0, 0)}
    bench.put(here, "left")
    bench.put(there, "right")
    bench.numbers += 1
    bench.admission.bar(bench.numbers)
    bench.admission.answered(bench.numbers)
    bench.show(epoch=2)
    for _ in range(10):  # "left" has ended, "right" goes on
        bench.advance(bench.timeout / 2)
        bench.put(there, "right")
        bench.step()
    assert (bench.status()["sender"], bench.take(Setpoint)) == ("right", [])
    bench.advance(2 * bench.timeout)
    bench.put(there, "right")
    bench.step()
    assert len(bench.take(Setpoint)) == 1


def test_a_set_point_that_waited_for_the_core_is_refused(bench: StreamBench) -> None:
    bench.delay = 0.3
    bench.put({"position": bench.tip(*A)})
    bench.run(1.0)
    assert (bench.status()["refused"], bench.take(Setpoint)) == (1, [])


def test_a_goal_ends_the_stream_before_it_and_waits_for_no_stream(bench: StreamBench) -> None:
    bench.search()
    (before,) = bench.take(Setpoint)
    program = bench.parts.next_number()
    bench.programs.offered = True
    bench.run(0.1)
    assert not bench.take(Setpoint), "a program is offered"
    assert bench.first is not None
    bench.admission.end_streams(bench.first)
    bench.programs.offered, bench.programs.last_accepted = False, program
    bench.run(0.1)
    assert not bench.take(Setpoint)
    assert not bench.status()["alive"]
    bench.position = None
    bench.run(2 * bench.timeout)
    bench.position = bench.tip(*A)
    bench.run(POLL)
    assert bench.take(Setpoint)[0].stream > program > before.stream


def test_a_declined_goal_does_not_end_the_stream(bench: StreamBench) -> None:
    bench.search()
    (before,) = bench.take(Setpoint)
    bench.parts.next_number()
    bench.programs.offered = True
    bench.run(0.1)
    bench.programs.offered = False
    bench.run(2 * POLL)
    assert bench.take(Setpoint)[0].stream == before.stream


@pytest.mark.parametrize("mode", ["stopped", "fault", "starting"])
def test_a_mode_without_motion_ends_the_stream(bench: StreamBench, mode: str) -> None:
    bench.search()
    bench.take(Setpoint)
    bench.show(mode=mode)
    bench.run(1.0)
    bench.show(mode="ready")
    bench.run(1.0)
    assert not bench.take(Setpoint)


def test_a_lost_executor_ends_the_stream(bench: StreamBench) -> None:
    bench.search()
    bench.take(Setpoint)
    bench.view.lost("the executor is gone")
    bench.admission.lost()
    bench.run(0.1)
    assert not bench.take(Setpoint)
    assert not bench.status()["alive"]


def test_a_failed_search_ends_the_stream(bench: StreamBench) -> None:
    number, _ = bench.search()
    bench.take(Setpoint)
    bench.answer(number, Failed("a defect"))
    bench.step()
    bench.run(1.0)
    assert not bench.take(Setpoint)
    assert [line.text for line in bench.take(Log) if line.level == logging.ERROR] == [
        "following failed, the arm holds: a defect"
    ]
