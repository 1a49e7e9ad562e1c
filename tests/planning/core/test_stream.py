"""The stream of set-points: its searches, its stages, and its ends."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.process import Log
from hyperbit.controller.planning.core.events import Abandon, Start
from hyperbit.controller.planning.core.stream import ALIVE_EVERY, POLL, RETRY
from hyperbit.controller.planning.core.tasks import Failed, FollowSetpoint, VersionedScene
from hyperbit.controller.program import Setpoint
from tests.planning.core.stream_bench import TICK, A, StreamBench


@pytest.fixture
def bench(small: Arm) -> StreamBench:
    return StreamBench(small)


def test_a_setpoint_is_searched_and_its_stages_are_sent(bench: StreamBench) -> None:
    number, task = bench.search()
    assert task.basis.start == bench.view.state.start  # type: ignore[union-attr]
    assert task.position == pytest.approx(bench.tip(*A))
    assert (task.tolerance, task.basis.tables, task.basis.scene) == (0.01, bench.locks.tables, bench.obstacles.scene)
    assert bench.take(Setpoint)[0].stages == (), "the stream begins before the search ends"
    bench.found(number, (bench.states(*A),))
    (command,) = bench.take(Setpoint)
    assert (command.start, command.epoch, command.strict) == (bytes(2), 1, False)
    assert (command.stages, command.reason) == ((bench.states(*A),), "following a setpoint")
    assert command.until == pytest.approx(bench.now + bench.timeout, abs=2 * TICK)
    bench.run(2 * POLL)
    assert bench.take(Start), "the goal moves: the next search begins"


def test_one_search_at_a_time_while_the_stream_is_kept_alive(bench: StreamBench) -> None:
    bench.search()
    bench.take(Setpoint)
    bench.run(10 * ALIVE_EVERY)
    assert not bench.take(Start)
    commands = bench.take(Setpoint)
    assert len(commands) in range(7, 11)
    assert all(command.stages == () for command in commands)


def test_the_arm_stays_where_the_goal_is(bench: StreamBench) -> None:
    bench.position = bench.tip(0, 0, 0, 0)
    bench.run(0.1)
    assert not bench.take(Start)
    assert all(command.stages == () for command in bench.take(Setpoint))


def changed_outputs(bench: StreamBench) -> None:
    bench.show(outputs=bench.states(1, 0, 0, 0))


def changed_scene(bench: StreamBench) -> None:
    bench.obstacles.scene = VersionedScene(2, free=False)


def changed_tables(bench: StreamBench) -> None:
    assert bench.locks.tables is not None
    bench.locks.tables = bench.locks.tables._replace(generation=2)


@pytest.mark.parametrize("change", [changed_outputs, changed_scene, changed_tables])
def test_an_answer_for_another_start_scene_or_tables_is_dropped(
    bench: StreamBench, change: Callable[[StreamBench], None]
) -> None:
    number, _ = bench.search()
    change(bench)
    bench.found(number, (bench.states(*A),))
    assert all(command.stages == () for command in bench.take(Setpoint))
    _, again = bench.task(FollowSetpoint)
    assert again.basis.start == bench.view.state.start  # type: ignore[union-attr]
    assert (again.basis.scene, again.basis.tables) == (bench.obstacles.scene, bench.locks.tables)


def test_without_tables_or_scene_nothing_is_searched(bench: StreamBench) -> None:
    bench.position, bench.obstacles.scene = bench.tip(*A), None
    bench.run(0.1)
    assert not bench.take(Start)
    assert all(command.strict and not command.stages for command in bench.take(Setpoint))
    bench.obstacles.scene = VersionedScene(2, free=True)
    bench.run(2 * POLL)
    assert bench.take(Start)


def test_stages_are_repeated_until_the_next_search_ends(bench: StreamBench) -> None:
    number, _ = bench.search()
    bench.found(number, (bench.states(*A),))
    bench.run(2 * ALIVE_EVERY + POLL)
    commands = bench.take(Setpoint)[1:]
    assert len(commands) >= 2
    assert all(command.stages == (bench.states(*A),) for command in commands)
    bench.show(outputs=bench.states(*A))
    bench.run(2 * ALIVE_EVERY)
    assert bench.take(Setpoint)[-1].stages == (), "they have begun"


def test_new_obstacles_withdraw_stages_at_once(bench: StreamBench) -> None:
    number, _ = bench.search()
    bench.found(number, (bench.states(*A),))
    bench.run(POLL + TICK)
    number, _ = bench.task(FollowSetpoint)
    bench.take(Setpoint)
    bench.obstacles.scene = None
    bench.stream.park()
    assert [command.stages for command in bench.take(Setpoint)] == [()]
    assert bench.take(Abandon) == [Abandon(number)]
    bench.found(number, (bench.states(*A),))
    bench.run(0.1)
    assert all(command.stages == () for command in bench.take(Setpoint))


def test_a_stream_waits_for_the_epoch_in_which_it_began(bench: StreamBench) -> None:
    bench.admission.fence(1)
    bench.position = bench.tip(*A)
    bench.run(0.1)
    assert not bench.take(Setpoint)
    bench.admission.answered(1)
    bench.show(epoch=2)
    bench.run(2 * POLL)
    assert bench.take(Setpoint)[0].epoch == 2


@pytest.mark.parametrize(
    ("note", "found"),
    [(", which is out of reach at (5.0000, 5.0000)", False), (", but the transition to it is blocked", True)],
)
def test_a_setpoint_that_cannot_be_followed_says_so_and_is_tried_again(
    bench: StreamBench, note: str, found: bool
) -> None:
    number, _ = bench.search()
    bench.found(number, note=note, found=found)
    bench.take(Setpoint)
    bench.run(RETRY - 2 * POLL)
    assert not bench.take(Start)
    command = bench.take(Setpoint)[-1]
    assert (command.stages, command.reason) == ((), f"following a setpoint{note}")
    bench.run(4 * POLL)
    bench.task(FollowSetpoint)


def test_an_arm_in_no_configuration_says_so(bench: StreamBench) -> None:
    bench.show(known=bytes(2))
    bench.position = bench.tip(*A)
    bench.run(0.1)
    assert not bench.take(Start)
    assert bench.take(Setpoint)[-1].reason == (
        "following a setpoint, which is not possible now: the arm is ready, and a state is not known: holding"
    )


def test_a_search_waits_for_the_end_of_the_running_stage(bench: StreamBench) -> None:
    bench.show(mode="executing", moving=True, free_at=bench.now + 0.1)
    bench.position = bench.tip(*A)
    bench.run(0.05)
    assert not bench.take(Start)
    bench.run(0.05)
    assert bench.take(Start), "the next stage is known when this one ends"


def test_a_failed_search_from_a_state_that_has_passed_is_repeated(bench: StreamBench) -> None:
    number, _ = bench.search()
    changed_outputs(bench)
    bench.answer(number, Failed("the locked actuators have changed"))
    bench.step()
    bench.task(FollowSetpoint)
    assert not bench.take(Log)


def test_the_tip_bias_shifts_the_searched_position(small: Arm) -> None:
    bench = StreamBench(small, bias=(0.003, -0.001))
    _, task = bench.search()
    assert task.position == pytest.approx(bench.tip(*A) - np.array([0.003, -0.001]))


def test_set_clocks_do_not_touch_a_stream_without_stamps(bench: StreamBench) -> None:
    bench.search()
    bench.moment.wall += 3600.0
    bench.run(0.5)
    assert bench.status()["alive"]
    assert bench.status()["refused"] == 0


def test_refused_setpoints_are_counted_and_move_nothing(bench: StreamBench) -> None:
    bench.put({"position": [1.0]})
    bench.put({"position": [1.0, 0.0], "stamp": bench.wall - 10.0})
    bench.step()
    assert not bench.actions
    status = bench.status()
    assert (status["received"], status["refused"], status["alive"]) == (2, 2, False)
    assert status["last_refusal"].startswith("stamp: 10.000 s old")


def test_a_live_stream_wakes_the_core_seldom(bench: StreamBench) -> None:
    number, _ = bench.search()
    bench.found(number)
    bench.steps = 0
    bench.run(1.0)
    assert bench.steps <= 110, "set-points and commands, 50 each, while a search is under way"
    assert bench.status()["rate"] == pytest.approx(50, rel=0.1)


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
