"""The stream of set-points in numbers: how often it searches, commands and wakes, and what it searches for."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
import pytest

from hyperbit.controller.planning.core.events import Answered
from hyperbit.controller.planning.core.stream import ALIVE_EVERY, RETRY
from hyperbit.controller.planning.core.tasks import Failed, Followed, FollowSetpoint
from hyperbit.controller.program import Setpoint
from tests.planning.rig.desk import SETPOINT_EVERY, Desk

A = (5, 0, 7, 0)


def commands(desk: Desk) -> list[Setpoint]:
    """Takes the commands of the stream since the last call."""
    taken = [message for message in desk.executor.messages if isinstance(message, Setpoint)]
    desk.executor.messages.clear()
    return taken


def test_a_set_point_is_searched_as_it_came_and_followed_for_the_time_out(desk: Desk) -> None:
    desk.held = {FollowSetpoint}
    desk.stream(desk.tip(*A), SETPOINT_EVERY)
    _, task = desk.waiting(FollowSetpoint)
    assert (task.position, task.tolerance) == (pytest.approx(desk.tip(*A)), 0.01)
    assert task.basis.start.states == bytes(2)
    commands(desk)
    desk.release(FollowSetpoint)
    (command,) = commands(desk)
    assert (command.start, command.epoch, command.strict) == (bytes(2), 1, False)
    assert command.until == pytest.approx(desk.now - SETPOINT_EVERY + 0.25, abs=0.002)
    configuration = desk.arm.manipulator.configuration(
        np.unpackbits(np.frombuffer(command.stages[-1], np.uint8), count=12, bitorder="little")
    )
    assert np.linalg.norm(np.subtract(desk.tip(*configuration), desk.tip(*A))) <= 0.01


def test_one_search_at_a_time_while_the_stream_is_kept_alive(desk: Desk) -> None:
    desk.held = {FollowSetpoint}
    desk.stream(desk.tip(*A), 10 * ALIVE_EVERY)
    assert desk.started[FollowSetpoint] == 1
    assert len(sent := commands(desk)) in range(7, 12)
    assert all(command.stages == () for command in sent)


def test_stages_are_repeated_until_they_have_begun(desk: Desk) -> None:
    desk.stream(desk.tip(*A), SETPOINT_EVERY)
    stages = commands(desk)[-1].stages
    desk.held = {FollowSetpoint}
    desk.stream(desk.tip(*A), 4 * ALIVE_EVERY)
    assert len(sent := commands(desk)) >= 2
    assert all(command.stages == stages for command in sent)


@pytest.mark.parametrize(
    ("note", "found"),
    [(", which is out of reach at (5.0000, 5.0000)", False), (", but the transition to it is blocked", True)],
)
def test_a_search_without_stages_is_told_and_made_again_after_a_while(desk: Desk, note: str, found: bool) -> None:
    desk.held = {FollowSetpoint}
    desk.stream(desk.tip(*A), SETPOINT_EVERY)
    number, _ = desk.waiting(FollowSetpoint)
    del desk.queued[number]
    desk.post(Answered(number, Followed((), note, found, 0.004), True))
    desk.stream(desk.tip(*A), RETRY - SETPOINT_EVERY)
    assert (desk.started[FollowSetpoint], commands(desk)[-1].reason) == (1, f"following a setpoint{note}")
    desk.stream(desk.tip(*A), 3 * SETPOINT_EVERY)
    assert desk.started[FollowSetpoint] == 2


def test_a_search_that_fails_from_a_state_that_has_passed_is_made_again(desk: Desk) -> None:
    desk.held = {FollowSetpoint}
    desk.stream(desk.tip(*A), SETPOINT_EVERY)
    number, _ = desk.waiting(FollowSetpoint)
    del desk.queued[number]
    desk.executor.show(outputs=1)
    desk.post(Answered(number, Failed("the locked actuators have changed"), True))
    assert desk.started[FollowSetpoint] == 2
    assert not [line for line in desk.lines if line.level >= logging.ERROR]


def test_a_live_stream_wakes_the_core_seldom(desk: Desk) -> None:
    desk.held = {FollowSetpoint}
    desk.stream(desk.tip(*A), SETPOINT_EVERY)
    before = desk.steps
    desk.stream(desk.tip(*A), 2.0)
    assert (desk.steps - before) / 2 <= 250, "set-points and commands, 50 each, and keep-alives"
    assert desk.published["diagnostics"]["setpoint"]["rate"] == pytest.approx(50, rel=0.1)


def test_the_tip_bias_shifts_the_searched_position(make_tracked: Callable[[], Desk]) -> None:
    desk, bias = make_tracked(), np.array([0.003, -0.001])
    for _ in range(100):
        desk.pass_time(0.02)
        desk.measure((np.array(desk.tip(0, 0, 0, 0)) + bias).tolist())
    desk.held = {FollowSetpoint}
    desk.stream(desk.tip(*A), SETPOINT_EVERY)
    assert desk.waiting(FollowSetpoint)[1].position == pytest.approx(desk.tip(*A) - bias, abs=1e-4)
