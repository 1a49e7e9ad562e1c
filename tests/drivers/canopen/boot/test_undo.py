"""A refused board stays as it was found: its objects and its NMT state."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, State
from hyperbit.drivers.simulation.variants import VARIANTS, StandingError
from tests.drivers.canopen.boot.test_pins import BOARD, boot, extended
from tests.drivers.rig import World, one_board

CHANGING = (0x1001, 0x1003, 0x6000)  # values that the board sets itself


def values(world: World) -> dict[tuple[int, int], bytes]:
    board = world.boards.board("can0/5")
    places = [(index, sub) for index, subs in board.variant.objects.items() for sub in subs if index not in CHANGING]
    return {place: board.objects.value(*place) for place in places}


def test_a_board_with_an_error_is_pre_operational_again():
    variant = replace(VARIANTS["standard"], errors=(StandingError(0xFF00, 0x80),))
    world = World(one_board(), variants={"can0/5": variant}, on_loss="contract")
    world.run(0.05)
    before = values(world)
    [sentence] = boot(world)
    assert "1001h sub 0 is 80h" in sentence
    assert values(world) == before
    assert world.boards.board("can0/5").state is State.PRE_OPERATIONAL


def test_a_stopped_board_is_stopped_again_and_its_outputs_stay_off():
    world = extended(on_loss="contract")
    board = world.boards.board("can0/5")
    board.objects.refused[0x6005, 0] = 0x06060000
    [sentence] = boot(world)
    assert "6005h" in sentence
    assert board.state is State.STOPPED
    world.run(0.5)
    assert world.positions() == [0.0, 0.0]


def test_an_operational_board_is_operational_again_and_its_outputs_hold():
    world = World(one_board(), variants=BOARD, on_loss="hold").up()
    world.commit(1, 1, then=0.3)
    world.wiring = replace(world.wiring, on_loss="contract")
    world.new_master()
    board = world.boards.board("can0/5")
    board.variant = board.objects.variant = replace(board.variant, deaf=frozenset({0x1029}))
    before = values(world)
    [sentence] = boot(world)
    assert "1029h" in sentence
    assert (board.state, world.positions()) == (State.OPERATIONAL, [1.0, 1.0])
    assert values(world) == before


def stop_after(world: World, answers: int) -> list[str]:
    """Boots; another program stops the board after a number of SDO answers. Returns the sentences of the refusal."""
    left = answers

    def stop(bus: str, frame: cia301.Frame) -> bool:
        nonlocal left
        answer = frame.id == cia301.SDO_ANSWER + 5
        left -= answer
        if answer and left == 0:
            world.after(0.0, lambda: world.say(0, bytes([Command.STOP, 5])))
        return False

    world.lost = stop
    sentences = boot(world)
    assert left <= 0
    return sentences


@pytest.mark.parametrize("answers", [40, 43, 46])
def test_a_board_that_was_stopped_in_its_boot_gets_its_objects_back(answers):
    variant = replace(VARIANTS["sync-period"], deaf=frozenset({0x1029}))
    world = World(one_board(), variants={"can0/5": variant}, on_loss="contract")
    world.run(0.05)
    before = values(world)
    [sentence] = stop_after(world, answers)
    assert "1029h" in sentence
    assert values(world) == before
    assert world.boards.board("can0/5").state is State.PRE_OPERATIONAL


def test_a_board_that_was_stopped_after_its_start_is_started_again():
    world = World(one_board())
    board, stopped = world.boards.board("can0/5"), []

    def watch() -> None:
        if board.state is State.OPERATIONAL:
            stopped.append(world.now)
            world.say(0, bytes([Command.STOP, 5]))
        else:
            world.after(0.001, watch)

    watch()
    assert boot(world) == []
    assert stopped
    assert board.state is State.OPERATIONAL
