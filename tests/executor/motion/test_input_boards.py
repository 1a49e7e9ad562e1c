"""The executor on arms whose end-stops are on a board without outputs, also on another bus."""

from __future__ import annotations

import pytest

from hyperbit.controller.program import Answer, Ended, Reset, Snapshot, unpack
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import BoardId
from tests.executor.rig import SIZE
from tests.executor.world import A, B, World, ready

ALL = (1 << SIZE) - 1
BOARDS = [BoardId("can0", 9), BoardId("can1", 1)]  # the second has the node id of a board of outputs


def up(board: BoardId) -> World:
    world = ready(input_board=board, channel={"input_contracted": True})
    assert unpack(world.last(Snapshot).known) == ALL
    return world


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_a_program_moves_actuators_and_their_arrival_is_measured_on_the_other_board(board: BoardId) -> None:
    world = up(board)
    world.run(1, A, B)
    world.go(0.1)
    assert unpack(world.last(Snapshot).measured) == A
    world.go(0.9)
    assert world.last(Ended).status == "done", world.logged
    assert unpack(world.last(Snapshot).measured) == B
    assert sum(round(position) << k for k, position in enumerate(world.boards.positions())) == B


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_a_stuck_actuator_is_found_by_its_end_stop(board: BoardId) -> None:
    world = up(board)
    world.fault("stick", "2.left", 0)
    world.run(1, ALL)
    world.go(1.0)
    assert world.mode == "fault"
    assert "2.left (can0/2 output 0) did not become extended" in world.last(Ended).message


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_a_lost_message_of_end_stops_is_made_good_by_a_question_to_their_board(board: BoardId) -> None:
    world = up(board)
    lost: list[Frame] = []

    def lossy(bus: str, frame: Frame) -> bool:
        if bus != board.bus or frame.id != 0x180 + board.node:
            return False
        lost.append(frame)
        return True

    world.lost = lossy
    world.run(1, A)
    world.go(1.0)
    assert lost
    assert (world.mode, world.last(Ended).status) == ("ready", "done"), world.logged
    assert unpack(world.last(Snapshot).measured) == A


@pytest.mark.parametrize("verb", ["cut_wires", "short_wires", "lose_sensor"])
def test_faulty_wires_of_end_stops_are_found_on_the_other_board(verb: str) -> None:
    world = up(BOARDS[0])
    world.fault(verb, "1.left")
    world.run(1, A)
    world.go(1.0)
    assert world.mode == "fault"
    assert "1.left" in world.last(Ended).message


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_without_the_board_of_end_stops_nothing_is_known_and_the_arm_recovers_with_it(board: BoardId) -> None:
    world = up(board)
    world.run(1, A)
    world.go(1.0)
    world.fault("silence", str(board))
    world.go(1.0)
    assert world.mode == "fault"
    assert f"board {board}" in world.core.modes.reason
    assert unpack(world.last(Snapshot).known) == 0, "the boards of the outputs are ready, but no end-stop is read"
    syncs = len(world.syncs)
    world.fault("unsilence", str(board))
    world.go(3.0)
    if world.mode == "fault":
        world.send(Reset(1, world.epoch))
        world.go(3.0)
        assert world.last(Answer).accepted
    assert world.mode == "ready", world.logged
    assert (unpack(world.last(Snapshot).known), unpack(world.last(Snapshot).measured)) == (ALL, A)
    assert len(world.syncs) == syncs, "a recovery switches nothing"
    world.run(2, B)
    world.go(1.0)
    assert world.last(Ended).status == "done"


def test_the_arm_does_not_start_without_the_board_of_its_end_stops() -> None:
    world = World(input_board=BOARDS[0])
    world.fault("silence", str(BOARDS[0]))
    world.agenda.until(lambda: world.mode == "fault")
    assert "can0/9" in world.core.modes.reason
    assert unpack(world.last(Snapshot).known) == 0
