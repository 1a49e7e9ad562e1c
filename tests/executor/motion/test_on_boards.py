"""The executor on the real CANopen master and simulated boards, on a simulated clock."""

from __future__ import annotations

import pytest

from hyperbit.controller.executor.core.events import FromClient
from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import (
    TICK,
    Accepted,
    Begun,
    BoardErrors,
    Diagnostics,
    Ended,
    ReadErrors,
    Reset,
    Settled,
    Snapshot,
    Stop,
    unpack,
)
from tests.executor.rig import PLANNER, SIZE, TRAVEL
from tests.executor.world import STEP, A, B, World, ready


@pytest.fixture
def world() -> World:
    return ready()


def test_a_program_moves_the_actuators_and_its_sync_leaves_with_its_message(world: World) -> None:
    world.go(STEP)
    world.run(1, A, B)
    world.go(STEP)
    assert len(world.syncs) == 1, "without waiting for a tick"
    assert world.of(Accepted)
    world.go(0.6)
    assert [(m.mark, m.switches, unpack(m.measured)) for m in world.of(Settled)] == [(0, 3, A), (1, 7, B)]
    assert [m.stage for m in world.of(Begun)] == [0, 1]
    assert world.last(Ended).status == "done"
    assert world.boards.drives() == [B >> k & 1 for k in range(SIZE)]
    assert world.journal.counts == world.boards.switches()


def test_an_actuator_that_sticks_is_found_and_reset_goes_on_with_it_released(world: World) -> None:
    world.fault("stick", "1.left", 0)
    world.run(1, A)
    world.go(0.3)
    assert (world.mode, world.last(Ended).status) == ("fault", "aborted")
    assert [fault.code for fault in world.last(Snapshot).faults] == ["stuck"]
    world.fault("release", "1.left")
    world.go(0.5)
    world.send(Reset(1, world.epoch))
    world.go(2.0)
    assert world.mode == "ready", world.logged
    world.run(2, 0)
    world.go(0.3)
    assert world.last(Ended).status == "done"
    assert world.journal.counts == world.boards.switches()


def test_one_toggled_at_every_transition_that_sticks_is_found(world: World) -> None:
    world.fault("stick", "1.left", 0)
    number = 0
    while world.mode != "fault" and number < 30:
        number += 1
        world.run(number, unpack(world.last(Snapshot).outputs) ^ 1)
        world.go(TRAVEL + TICK)
    assert number < 10
    assert "missed 3 commands" in world.core.modes.reason


def test_the_fault_of_a_lost_board_clears_when_the_board_is_back(world: World) -> None:
    world.run(1, A, B, step=5.0)
    world.go(0.1)
    world.fault("silence", "can0/2")
    world.go(1.0)
    assert (world.mode, world.last(Ended).status) == ("fault", "aborted")
    world.fault("unsilence", "can0/2")
    world.go(4.0)
    assert world.mode == "ready", world.logged
    assert world.last(Snapshot).faults == ()
    world.go(1.0)
    assert len(world.syncs) == 1, "nothing moves by itself"


def test_a_halted_executor_lets_the_boards_hold_and_acts_on_nothing_old(world: World) -> None:
    world.run(1, A, B, step=1.0)
    world.go(0.1)
    world.executor.stall(3.0)
    world.go(3.0)
    world.run(2, B)
    world.go(0.1)
    assert (world.mode, len(world.syncs)) == ("fault", 1)


@pytest.mark.parametrize("code", ["8130", "2320", "8120"])
def test_frames_that_waited_during_a_stall_are_no_fault_after_a_reset(world: World, code: str) -> None:
    world.executor.stall(3.0)
    world.go(1.5)
    world.fault("error", "can0/1", code)
    world.go(1.5 - STEP)
    world.fault("error_over", "can0/1", code)
    world.executor._events.appendleft(FromClient(PLANNER, Reset(1, world.epoch + 1)))  # of the stall's fault
    world.go(1.0)
    assert world.mode == "ready", world.logged
    assert world.last(Snapshot).faults == ()


def test_halt_and_end(world: World) -> None:
    world.run(1, A, B)
    world.send(Stop(1))
    assert world.mode == "stopped"
    world.post(Quit())
    assert world.ended
    assert len(world.of(Ended)) == 1


def test_diagnostics_tell_of_buses_and_boards(world: World) -> None:
    world.go(1.1)
    diagnostics = world.last(Diagnostics)
    assert [bus["name"] for bus in diagnostics.buses] == ["can0"]
    assert {board["state"] for board in diagnostics.boards} == {"operational"}


@pytest.mark.parametrize("sensed", [0, 0b111111])
def test_a_restarted_executor_adopts_the_present_states(sensed: int) -> None:
    world = ready(sensed=sensed)
    world.run(1, A)
    world.go(0.2)
    world.executor.kill()
    world.heard.clear()
    world.syncs.clear()
    world.executor.start()
    world.connect()
    world.go(2.0)
    assert world.mode == "ready", world.logged
    assert unpack(world.last(Snapshot).outputs) == A
    assert world.syncs == []


def test_errors_of_a_board_are_read_in_motion_and_in_fault_and_add_none(world: World) -> None:
    world.run(1, A, B, A)
    world.send(ReadErrors(7, "can0/1"))
    world.go(1.0)
    assert world.last(BoardErrors) == BoardErrors(7, "", 0, ())
    assert world.last(Ended).status == "done"
    world.fault("error", "can0/1", 5000)
    world.go(0.5)
    assert world.mode == "fault"
    for request in (8, 9):
        world.send(ReadErrors(request, "can0/1"))
        world.go(0.5)
        assert world.last(BoardErrors) == BoardErrors(request, "", 0x01, (0x5000,))
