"""Faults of boards and of the master in operation: how they are found, what is told, and how the arm comes back."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.sdo.errors import Errors
from hyperbit.drivers.canopen.wire.cia301 import SDO_ANSWER, Command, Frame, State
from hyperbit.drivers.canopen.wire.events import BusChanged, FrameEchoed
from tests.drivers.rig import World


def only(world: World) -> tuple[str, str, str]:
    [fault] = world.faults
    return fault.code, fault.source, fault.message


# Silence, of boards and of the master.


@pytest.mark.parametrize(("beat_lost", "later", "halted"), [(False, -0.03, False), (True, 0.02, True)])
def test_a_pause_counts_from_the_last_heartbeat_that_was_sent(beat_lost: bool, later: float, halted: bool) -> None:
    """A board loses its master `heartbeat_timeout` after it; a heartbeat that was not sent shortens no pause."""
    world = World().up()
    world.beats.clear()
    world.until(lambda: world.beats)
    [beat], timing = world.beats, world.timing
    if beat_lost:
        world.run(timing.heartbeat - 0.02)
        world.buses["can0"].room = 0
        world.run(0.03)  # the next heartbeat and its repetition are not sent
    world.stalled = True
    world.run(beat + timing.heartbeat_timeout + later - world.now)
    assert (world.master.find_pause(world.now) is not None) is halted


# Frames of others.


def test_another_program_on_the_same_computer_is_another_master() -> None:
    world = World().up()
    world.master.receive_event(FrameEchoed("can0", Frame(0x205, b"\x00"), None), world.now)
    assert world.told() == ["foreign-master"]


def doubling(world: World, every: int) -> World:
    answers: list[Frame] = []

    def twice(bus: str, frame: Frame) -> bool:
        answers.extend([frame] if frame.id == SDO_ANSWER + 5 else [])
        if frame.id == SDO_ANSWER + 5 and len(answers) % every == 0:
            world.buses[bus].from_other(frame)
        return False

    world.lost = twice
    return world


def test_two_boards_that_answer_as_one_are_noticed_and_the_board_stays_not_ready() -> None:
    world = doubling(World(), 1)
    for _ in range(2):
        world.faults.clear()
        world.boot()
        world.run(1.0)
        text = "two boards answer as can0/5: give each its own node id, then reset"
        assert only(world) == ("duplicate-node", "can0/5", text)
        assert not world.master.outputs_known


def test_a_bus_that_doubles_some_frames_and_heartbeats_that_come_at_once_are_no_fault() -> None:
    world = doubling(World(), 3).up()
    world.run(20.0)
    for _ in range(12):
        world.say(0x705, b"\x05")
    world.run(3.0)
    world.stall(0.2)
    world.run(3.0)
    assert world.faults == []


# What boards say of themselves.


def test_a_board_that_leaves_operational_is_told_with_the_remedy() -> None:
    world = World().up()
    world.say(0x705, bytes([State.PRE_OPERATIONAL]))
    world.run(0.01)
    code, source, text = only(world)
    assert (code, source) == ("board-stopped", "can0/5")
    assert "without a command and is pre-operational now: read its errors" in text
    assert text.endswith("hyperbit board ARM.yaml can0/5 reset --communication")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x2320, "output short circuit (2320h)"),
        (0x2345, "current at the output side (2345h)"),
        (0x5112, "device hardware (5112h)"),
        (0xFF01, "device specific (FF01h)"),
        (0xB123, "unknown error (B123h)"),
        (0x0123, "unknown error (0123h)"),
    ],
)
def test_a_storm_of_emergencies_is_one_fault_in_words(code: int, words: str) -> None:
    world = World().up()
    for number in (code, *range(0x2300, 0x2400), code):
        world.say(0x085, number.to_bytes(2, "little") + b"\x01\0\0\0\0\0")
    world.run(0.1)
    text = f"board can0/5: it reports {words}: remove the cause, then reset"
    assert only(world) == ("emergency", "can0/5", text)
    assert world.master.status().boards[0].emergency == words
    world.say(0x085, bytes(8))
    world.run(0.01)
    assert world.master.status().boards[0].emergency is None


def test_too_few_inputs_are_a_fault_and_of_more_the_first_ones_count_with_one_warning() -> None:
    world = World().up()
    for data in (b"\x01\xff", b"\x03" + bytes(7), b"\x01" + bytes(7)):
        world.say(0x185, data)
        world.run(0.01)
        assert world.measured() == [data[0] & 1, data[0] >> 1]
    [limits] = world.master.warnings()
    assert (limits.code, world.told()) == ("board-limits", [])
    assert "its inputs come in 2 bytes, though 1 are mapped: only the first ones are used" in limits.message
    assert "8 bytes" in limits.message
    world.say(0x185, b"")
    world.run(0.01)
    assert (only(world)[0], world.measured()) == ("wrong-length", [1, 0])
    assert "its inputs came in 0 bytes, not in 1" in only(world)[2]


def read_errors(world: World) -> Errors | ArmFault:
    world.master.errors.ask(0)
    told: list[tuple[int, Errors | ArmFault]] = []
    world.until(lambda: told or told.extend(world.master.errors.drain()), 60)
    [(board, found)] = told
    assert board == 0
    return found


def test_errors_are_read_after_a_boot_while_the_arm_is_ready_and_in_fault() -> None:
    world = World()
    world.run(0.05)
    world.master.boot(world.now)
    assert read_errors(world) == Errors(0, ())
    assert (world.master.booting.under_way, world.master.booting.faults) == (False, [])
    world.fault("error", "can0/5", 5000)
    world.run(0.1)
    assert read_errors(world) == Errors(0x01, (0x5000,))
    assert world.boot() != []
    assert read_errors(world) == Errors(0x01, (0x5000,))


def test_no_errors_are_read_from_a_board_that_is_silent_or_stopped_or_whose_bus_is_lost() -> None:
    for variant, words in (("standard", "does not answer to 1001h"), ("guarding-only", "does not")):
        world = World(variant=variant).up()
        world.fault("silence", "can0/5")
        assert words in read_errors(world).message
    world = World().up()
    world.nmt(Command.STOP)
    world.until(lambda: world.master.status().boards[0].state == "stopped")
    assert read_errors(world).code == "board-stopped"
    world.master.receive_event(BusChanged("can0", "down", "it is down", None), world.now)
    assert read_errors(world).code == "bus-down"
