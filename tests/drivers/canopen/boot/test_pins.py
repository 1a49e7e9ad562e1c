"""START changes no pin: what 6200h gets before it, by the state in which the board is found and by its error mode.

A refused board stays as it was found.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from hyperbit.drivers.canopen.wire.cia301 import NMT, Command, Frame, State
from hyperbit.drivers.canopen.wiring import Channel
from hyperbit.drivers.simulation import dictionary
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS
from tests.drivers.rig import World, one_board

LEAVE_BOARD, LEAVE_ALL = (bytes([Command.PRE_OPERATIONAL, node]) for node in (5, 0))
OF_THE_BOARD = (0x1001, 0x1003, 0x6000)  # values that a board sets itself
DEAF_1029H = replace(STANDARD, deaf=frozenset({0x1029}))
SENT_STAGED = bytes.fromhex("60006201")  # the board's answer to the first of two steps that write 6200h


def extended(**options: object) -> World:
    """Both actuators are extended, and without the master their outputs go off."""
    world = World(**{"on_loss": "contract", **options}).up()
    world.commit(1, 1, then=0.3)
    return world


def refused(world: World) -> str:
    [fault] = world.boot()
    return fault.message


@pytest.mark.parametrize("inverted", [False, True])
def test_what_a_running_master_has_commanded_stays_after_a_command_of_another_program(inverted: bool) -> None:
    channels = [replace(it, inverted=frozenset({"output"} if inverted else ())) for it in one_board()]
    world = World(channels, on_loss="contract").up()
    world.commit(1, 1, then=0.3)
    before = world.outputs(), world.positions(), world.switches()
    assert before[:2] == (0b00 if inverted else 0b11, [1.0, 1.0])
    for data in (LEAVE_ALL, LEAVE_BOARD):
        world.say(NMT, data)
        world.run(0.2)
    assert world.boot() == []
    world.run(0.5)
    assert (world.outputs(), world.positions(), world.switches()) == before
    assert world.warned() == []


OFF_OUTSIDE = {"variant": "off-in-preoperational", "error_state": "off"}


@pytest.mark.parametrize(
    ("frames", "pause", "options"),
    [
        ([(NMT, bytes([Command.STOP, 0])), (NMT, LEAVE_ALL)], 0.0, {}),
        ([(NMT, bytes([Command.STOP, 5])), (NMT, LEAVE_BOARD)], 0.0, {}),
        ([(NMT, bytes([Command.STOP, 0])), (NMT, bytes([Command.START, 0])), (NMT, LEAVE_ALL)], 0.0, {}),
        ([(NMT, bytes([Command.STOP, 5])), (NMT, bytes([Command.START, 5])), (NMT, LEAVE_BOARD)], 0.0, {}),
        ([(NMT, LEAVE_BOARD), (0x605, bytes.fromhex("2f00620101000000"))], 0.2, {}),  # another program has written
        ([(NMT, LEAVE_BOARD)], 0.2, OFF_OUTSIDE),
        ([(NMT, LEAVE_BOARD), (0x085, bytes.fromhex("1081110000000000"))], 0.2, {}),  # it has lost its master meanwhile
        ([(NMT, LEAVE_BOARD), (0x705, bytes([State.STOPPED]))], 0.2, {}),
    ],
)
def test_what_may_have_gone_off_or_was_written_meanwhile_is_written_off(
    frames: list[tuple[int, bytes]], pause: float, options: dict[str, object]
) -> None:
    world = extended(**options)
    for cob_id, data in frames:
        world.say(cob_id, data)
        world.run(0.02)
    world.run(pause)
    assert world.boot() == []
    world.run(0.5)
    assert (world.outputs(), world.positions()) == (0, [0.0, 0.0])


@pytest.mark.parametrize("silent", [True, False], ids=["the board is lost", "the master stands still"])
def test_what_nobody_has_heard_meanwhile_is_written_off(silent: bool) -> None:
    world = extended()
    world.say(NMT, LEAVE_BOARD)
    world.run(0.2)
    if silent:
        world.lose(0x705)
        world.run(1.0)
        world.lose()
        world.run(0.5)
    else:
        world.stall(1.0)
        world.say(NMT, LEAVE_BOARD)
    assert world.boot() == []
    world.run(0.5)
    assert (world.outputs(), world.positions()) == (0, [0.0, 0.0])


def test_outputs_that_a_failed_boot_has_written_off_are_told_by_the_next_one() -> None:
    world = extended()
    world.lose_master()
    written: list[Frame] = []

    def silent_afterwards(bus: str, frame: Frame) -> bool:
        written.extend([frame] if frame.data[:4] == SENT_STAGED else [])
        return bool(written) and frame.id == 0x705

    world.lost = silent_afterwards
    assert "did not become operational" in refused(world)
    assert world.outputs() == 0
    world.lose()
    assert world.boot() == []
    assert world.warned() == ["outputs-off"]


@pytest.mark.parametrize("abort", ["", "01000405"], ids=["no answer", "05040001h"])
def test_a_board_that_takes_no_write_in_two_steps_gets_one(abort: str) -> None:
    channels = [Channel("5.left", "can0", 5, 0, None, on_loss="contract"), Channel("5.right", "can0", 5, 1, None)]
    world = World(channels).up()
    world.commit(1, 1, then=0.3)
    world.lose_master()
    refusals: list[Frame] = []

    def refuse(bus: str, frame: Frame) -> bool:
        if len(refusals) == 2 or frame.data[:4] != SENT_STAGED:
            return False
        refusals.append(frame)
        if abort:
            world.say(0x585, b"\x80" + frame.data[1:4] + bytes.fromhex(abort))
        return True

    world.lost = refuse
    assert world.boot() == []
    assert (world.outputs(), world.measured()) == (0b10, [0, 1])
    asked = [data for data in world.requests() if data[3:11] == "00 62 01" and data[:2] != "40"]
    assert [data[:2] for data in asked][:3] == ["21", "21", "2f"]


def test_no_entry_of_the_history_keeps_outputs_on() -> None:
    world = extended(variant="no-error-mode-off", on_loss="hold", error_state="device")
    world.lose_master()
    world.objects.set_number(0x1003, 1, 0x1B000000)  # the end of an error, as CANopenNode enters it
    world.objects.set_number(0x1003, 2, 0x8130)
    assert world.boot() == []
    assert world.outputs() == 0


def pins_of(world: World) -> list[int]:
    """Returns a list that takes the pins of the board, if they have changed, with each frame that it sends."""
    pins = [world.pins()]

    def watch(bus: str, frame: Frame) -> bool:
        pins.extend([world.pins()] if world.pins() != pins[-1] else [])
        return False

    world.lost = watch
    return pins


def test_a_running_master_knows_that_an_operational_board_holds() -> None:
    world = extended()
    world.objects.set_number(0x1029, 1, 1)
    pins = pins_of(world)
    assert world.boot() == []
    assert (pins, world.outputs(), world.measured()) == ([0b11], 0b11, [1, 1])


def test_a_refused_board_in_its_error_state_switches_no_output_on() -> None:
    """One coil contracts in the error state; 6200h has the other one on. 1029h = 1 leaves the board operational."""
    channels = [Channel("5.left", "can0", 5, 0, None, output_off=1, on_loss="contract")]
    world = World(channels, variant=replace(STANDARD, stored={(0x1029, 1): 2})).up()
    world.commit(1, 0, then=0.3)
    world.objects.set_number(0x1029, 1, 1)
    world.objects.variant = DEAF_1029H
    world.lose_master()
    board = world.board()
    assert (board.state, world.pins(), world.outputs()) == (State.OPERATIONAL, 0b10, 0b01)
    pins = pins_of(world)
    assert "1029h" in refused(world)
    assert (pins, board.state, world.objects.number(0x6206, 1)) == ([0b10, 0], State.OPERATIONAL, 0xFF)


def test_words_that_cannot_be_read_are_read_as_bytes() -> None:
    words = {
        **dictionary.array(0x6300, [0] * 4, size=2, mappable=True, readable=False),
        **dictionary.pdo(0x1400, 0x200, [0x6300 << 16 | sub << 8 | 16 for sub in range(1, 5)], fixed=True),
    }
    world = World([Channel("a", "can0", 5, 0, None)], variant=replace(STANDARD, changes=words))
    world.objects.set_number(0x6200, 1, 1)
    world.objects.set_number(0x6206, 1, 0)
    assert (world.boot(), world.master.outputs.commanded) == ([], 1)


def test_a_foreign_object_that_cannot_be_read_is_not_overwritten() -> None:
    mapped = dictionary.pdo(0x1400, 0x200, [0x62000108, 0x64110110], fixed=True)
    variant = VARIANTS["many-outputs"]
    world = World(variant=replace(variant, changes={**variant.changes, **mapped}))
    world.objects.refused[0x6411, 1] = 0x06010001
    assert refused(world).startswith("board can0/5 refuses to read 6411h sub 1")


def test_a_board_that_was_stopped_after_its_start_is_started_again() -> None:
    world, stopped = World(), []

    def watch() -> None:
        if world.board().state is State.OPERATIONAL:
            stopped.append(world.now)
            world.nmt(Command.STOP)
        else:
            world.after(0.001, watch)

    watch()
    assert world.boot() == []
    assert stopped
    assert world.board().state is State.OPERATIONAL
