"""START changes no pin: what 6200h gets before it, by the state in which the board is found and by its error mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, State
from hyperbit.drivers.simulation import dictionary
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import Channel, World, one_board

BOARD = {"can0/5": VARIANTS["standard"]}


def extended(**options: object) -> World:
    world = World(one_board(), **{"variants": BOARD, **options}).up()
    world.commit(1, 1, then=0.3)
    lose_master(world)
    return world


def lose_master(world: World) -> None:
    world.stalled = True
    world.run(1.0)
    world.stalled = False
    world.new_master()


def boot(world: World) -> list[str]:
    world.master.boot(world.now)
    world.until(lambda: not world.master.booting)
    return [fault.message for fault in world.master.boot_faults]


def outputs(world: World) -> int:
    return world.boards.board("can0/5").objects.number(0x6200, 1)


def test_outputs_that_the_error_state_switched_off_are_written_off_and_told():
    world = extended(on_loss="contract")
    assert world.boards.board("can0/5").state is State.STOPPED
    assert boot(world) == []
    assert outputs(world) == 0
    told = [(fault.code, fault.message) for fault in world.master.warnings()]
    text = "can0/5: outputs may have been switched off by the board; written off before start"
    assert told == [("outputs-off", text)]
    assert boot(world) == []
    assert world.master.warnings() == ()


def held(*frames: tuple[int, bytes], after: float = 0.2, **options: object) -> World:
    """An arm whose two actuators are extended; then another program sends frames, and the same master boots again."""
    world = World(one_board(), **{"variants": BOARD, "on_loss": "contract", **options}).up()
    world.commit(1, 1, then=0.3)
    for cob_id, data in frames:
        world.say(cob_id, data)
        world.run(0.02)
    world.run(after)
    assert boot(world) == []
    world.run(0.5)
    return world


def test_what_a_running_master_has_commanded_stays_on_after_a_command_of_another_program():
    world = held((0, bytes([Command.PRE_OPERATIONAL, 0])), (0, bytes([Command.PRE_OPERATIONAL, 5])))
    assert (outputs(world), world.positions(), world.switches()) == (0b11, [1.0, 1.0], [1, 1])
    assert world.master.warnings() == ()


def test_what_a_running_master_has_commanded_stays_also_at_inverted_outputs():
    channels = [replace(channel, inverted=frozenset({"output"})) for channel in one_board()]
    world = World(channels, variants=BOARD, on_loss="contract").up()
    world.commit(1, 1, then=0.3)
    assert (outputs(world), world.positions()) == (0, [1.0, 1.0])
    world.say(*LEAVE)
    world.run(0.2)
    assert boot(world) == []
    world.run(0.5)
    assert (outputs(world), world.positions(), world.master.warnings()) == (0, [1.0, 1.0], ())


LEAVE = (0, bytes([Command.PRE_OPERATIONAL, 5]))


@pytest.mark.parametrize(
    ("frames", "options"),
    [
        *(
            ([(0, bytes([command, board])) for command in (*commands, Command.PRE_OPERATIONAL)], {"after": 0.0})
            for board in (0, 5)
            for commands in ([Command.STOP], [Command.STOP, Command.START])
        ),
        ([LEAVE, (0x605, bytes.fromhex("2f00620101000000"))], {}),  # another program has written
        ([LEAVE], {"variants": {"can0/5": VARIANTS["off-in-preoperational"]}, "error_state": "off"}),
        ([LEAVE, (0x085, bytes.fromhex("1081110000000000"))], {}),  # it has lost its master meanwhile
        ([LEAVE, (0x705, bytes([State.STOPPED]))], {}),
    ],
)
def test_what_may_have_gone_off_or_was_written_meanwhile_is_written_off(frames, options):
    world = held(*frames, **options)
    assert (outputs(world), world.positions()) == (0, [0.0, 0.0])


def test_the_outputs_of_a_board_that_was_lost_meanwhile_are_written_off():
    world = World(one_board(), variants=BOARD, on_loss="contract").up()
    world.commit(1, 1, then=0.3)
    world.say(*LEAVE)
    world.run(0.2)
    world.lost = lambda bus, frame: frame.id == 0x705
    world.run(1.0)
    world.lost = lambda bus, frame: False
    world.run(0.5)
    assert boot(world) == []
    assert outputs(world) == 0


def test_outputs_that_a_failed_boot_has_written_off_are_told_by_the_next_one():
    world = extended(on_loss="contract")
    written = False

    def silent_afterwards(bus: str, frame: Frame) -> bool:
        nonlocal written
        written |= frame.data[:4] == bytes.fromhex("60006201")
        return written and frame.id == 0x705

    world.lost = silent_afterwards
    assert "did not become operational" in boot(world)[0]
    assert outputs(world) == 0
    world.lost = lambda bus, frame: False
    assert boot(world) == []
    assert [fault.code for fault in world.master.warnings()] == ["outputs-off"]


def test_a_master_that_stood_still_meanwhile_writes_off():
    world = World(one_board(), variants=BOARD, on_loss="contract").up()
    world.commit(1, 1, then=0.3)
    world.say(0, bytes([Command.PRE_OPERATIONAL, 5]))
    world.run(0.2)
    world.stall(1.0)
    world.say(0, bytes([Command.PRE_OPERATIONAL, 5]))
    assert boot(world) == []
    world.run(0.5)
    assert (outputs(world), world.positions()) == (0, [0.0, 0.0])


def test_a_board_that_takes_no_write_in_two_steps_gets_one():
    channels = [Channel("5.left", "can0", 5, 0, None, on_loss="contract"), Channel("5.right", "can0", 5, 1, None)]
    for abort in ("", "01000405"):  # no answer, or abort 05040001h
        world = World(channels, variants=BOARD).up()
        world.commit(1, 1, then=0.3)
        lose_master(world)
        world.lost = refusing(world, bytes.fromhex(abort))
        assert boot(world) == []
        assert (outputs(world), world.measured()) == (0b10, [0, 1])
        asked = [data for cob_id, data in world.frames(sdo=True) if cob_id == 0x605 and data[3:11] == "00 62 01"]
        assert [data[:2] for data in asked if data[:2] != "40"][:3] == ["21", "21", "2f"]


def refusing(world: World, abort: bytes) -> Callable[[str, Frame], bool]:
    """Lets the board refuse the first two writes of its outputs, which are in two steps; the third one is in one."""
    refused = 0

    def lost(bus: str, frame: Frame) -> bool:
        nonlocal refused
        if refused == 2 or frame.data[:4] != bytes.fromhex("60006201"):
            return False
        refused += 1
        if abort:
            world.say(0x585, b"\x80" + frame.data[1:4] + abort)
        return True

    return lost


def test_no_entry_of_the_history_keeps_outputs_on():
    variant = VARIANTS["no-error-mode-off"]
    world = extended(variants={"can0/5": variant}, error_state="device")
    board = world.boards.board("can0/5")
    board.objects.set_number(0x1003, 1, 0x1B000000)  # the end of an error, as CANopenNode enters it
    board.objects.set_number(0x1003, 2, 0x8130)
    assert boot(world) == []
    assert outputs(world) == 0


def test_outputs_are_not_written_while_the_board_is_operational():
    world = World(one_board(), on_loss="contract").up()
    world.commit(1, 1, then=0.3)
    world.wiring = replace(world.wiring, on_loss="hold")
    world.new_master()
    world.frames(sdo=True)
    assert boot(world) == []
    requests = [data for cob_id, data in world.frames(sdo=True) if cob_id == 0x605]
    written = [data for data in requests if data[0] == "2" and data[3:8] == "00 62"]
    assert (written, outputs(world), world.measured()) == ([], 0b11, [1, 1])


def stays_operational(world: World, behaviour: int = 1) -> list[int]:
    """Lets a board with two coils on one actuator lose its master with a value of 1029h, then takes the new pins.

    The coil that contracts is on in the error state, and the coil that extends is on in 6200h.
    """
    world.commit(1, 0, then=0.3)
    board = world.boards.board("can0/5")
    board.objects.set_number(0x1029, 1, behaviour)
    lose_master(world)
    assert (board.state, board.pins, outputs(world)) == (State.OPERATIONAL, 0b10, 0b01)
    return watched(world)


def watched(world: World) -> list[int]:
    """Returns a list that takes the pins of the board, if they have changed, with each frame that it sends."""
    board, pins = world.boards.board("can0/5"), [world.boards.board("can0/5").pins]

    def watch(bus: str, frame: Frame) -> bool:
        if board.pins != pins[-1]:
            pins.append(board.pins)
        return False

    world.lost = watch
    return pins


COILS = [Channel("5.left", "can0", 5, 0, None, output_off=1, on_loss="contract")]


def test_a_refused_board_in_its_error_state_switches_no_output_on():
    world = World(COILS, variants=BOARD).up()
    pins = stays_operational(world)
    board = world.boards.board("can0/5")
    board.variant = board.objects.variant = replace(board.variant, deaf=frozenset({0x1029}))
    [sentence] = boot(world)
    assert "1029h" in sentence
    assert (pins, board.state, board.objects.number(0x6206, 1)) == ([0b10, 0], State.OPERATIONAL, 0xFF)


def test_a_running_master_knows_that_an_operational_board_holds():
    world = World(one_board(), variants=BOARD, on_loss="contract").up()
    world.commit(1, 1, then=0.3)
    world.boards.board("can0/5").objects.set_number(0x1029, 1, 1)
    pins = watched(world)
    assert boot(world) == []
    assert (pins, outputs(world), world.measured()) == ([0b11], 0b11, [1, 1])


def test_words_that_cannot_be_read_are_read_as_bytes():
    words = {
        **dictionary.array(0x6300, [0] * 4, size=2, mappable=True, readable=False),
        **dictionary.pdo(0x1400, 0x200, [0x6300 << 16 | sub << 8 | 16 for sub in range(1, 5)], fixed=True),
    }
    world = World(
        [Channel("1.a", "can0", 5, 0, None)], variants={"can0/5": replace(VARIANTS["standard"], changes=words)}
    )
    world.boards.board("can0/5").objects.set_number(0x6200, 1, 1)
    world.boards.board("can0/5").objects.set_number(0x6206, 1, 0)
    world.boot()
    assert (world.master.boot_faults, world.master.outputs) == ([], 1)


def test_a_foreign_object_that_cannot_be_read_is_not_overwritten():
    variant = VARIANTS["many-outputs"]
    mapped = dictionary.pdo(0x1400, 0x200, [0x62000108, 0x64110110], fixed=True)
    variant = replace(variant, changes={**variant.changes, **mapped})
    world = World(one_board(), variants={"can0/5": variant})
    world.boards.board("can0/5").objects.refused[0x6411, 1] = 0x06010001
    world.boot()
    [fault] = world.master.boot_faults
    assert fault.message.startswith("board can0/5 refuses to read 6411h sub 1")
