"""Verification: missed switches and foreign changes are found within two seconds."""

from __future__ import annotations

import pytest

from drivers.canopen.wiring import Channel
from tests.drivers.canopen.world import World

BLIND = [Channel("5.left", "can0", 5, 0, None), Channel("9.left", "can0", 9, 3, None)]


def sdo(world: World, index: int, sub: int, value: int, size: int) -> None:
    """Another program writes to board 5."""
    board = world.boards.board("can0/5").objects
    board.set_data(index, sub, value.to_bytes(size, "little"))


def test_the_first_commit_ends_when_boards_without_end_stops_are_read_back():
    world = World(BLIND).up()
    world.commit(1, 1)
    frames = world.frames(sdo=True)
    assert frames[:3] == [(0x205, "01"), (0x209, "08"), (0x080, "")]
    assert {(0x605, "40 00 62 01 00 00 00 00"), (0x609, "40 00 62 01 00 00 00 00")} <= set(frames)
    assert world.master.commit_failed is None
    world.commit(0, 1)  # the second one is read back in the background
    assert world.frames(sdo=True)[-1] == (0x080, "")


def test_a_first_commit_that_a_board_does_not_follow_fails():
    world = World(BLIND).up()
    sdo(world, 0x1005, 0, 0x85, 4)  # just after the boot
    world.commit(1, 1)
    assert world.codes() == ["not-switched"]
    failed = world.master.commit_failed
    assert failed == world.faults[0].message
    assert "can0/5 has 00h in 6200h sub 1 (outputs); 01h was switched: it does not follow RPDO and SYNC" in failed
    assert world.measured() == [-1, 1]
    world.up()  # a reset configures the board again
    assert world.measured() == [0, 1]
    world.commit(1, 1)
    assert world.master.commit_failed is None


@pytest.mark.parametrize("end_stop", [None, 0])
def test_a_board_that_stops_switching_later_is_noticed_within_two_seconds(end_stop):
    world = World([Channel("5.left", "can0", 5, 0, end_stop)]).up()
    world.commit(1)
    world.run(0.5)
    sdo(world, 0x1005, 0, 0x85, 4)
    world.commit(0)
    assert world.until(lambda: world.codes()) < 2
    assert world.codes() == ["not-switched"]


def test_another_program_that_switches_an_output_is_noticed():
    world = World(BLIND).up()
    world.commit(1, 1)
    world.run(0.5)
    sdo(world, 0x6200, 1, 0x00, 1)
    assert world.until(lambda: world.codes()) < 2
    assert world.codes() == ["not-switched"]


@pytest.mark.parametrize(
    ("index", "sub", "value", "size"),
    [(0x1005, 0, 0x85, 4), (0x1400, 2, 255, 1), (0x1016, 1, 0, 4), (0x6206, 1, 0xFF, 1), (0x1029, 1, 1, 1)],
)
def test_another_program_that_changes_a_board_is_noticed(index, sub, value, size):
    world = World(BLIND).up()
    sdo(world, index, sub, value, size)
    assert world.until(lambda: world.codes()) < 10
    assert world.codes() == ["board-changed"]
    assert f"can0/5 has {value:0{2 * size}X}h in {index:04X}h sub {sub}" in world.faults[0].message
    world.up()
    world.run(5)
    assert world.codes() == ["board-changed"]


def test_an_error_of_which_no_emergency_was_heard_is_noticed():
    world = World(BLIND).up()
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x09)
    world.until(lambda: world.codes())
    assert world.codes() == ["board-error"]
    assert "1001h sub 0 is 09h" in world.faults[0].message


def test_reading_back_takes_little_of_the_bus():
    world = World([Channel(f"{n}", "can0", n, 0, None) for n in range(1, 21)], bitrate=125_000).up()
    world.run(1.0)
    world.frames(sdo=True)
    world.run(10.0)
    requests = [frame for frame in world.frames(sdo=True) if frame[0] & 0x780 == 0x600]
    assert 20 < len(requests) < 60  # two frames of at most 135 bits each: less than 1.3 % of 125 kbit/s
    assert world.faults == []


def test_nothing_is_read_of_boards_that_switch_all_the_time_but_they_are_no_fault():
    world = World(BLIND).up()
    for k in range(200):
        world.commit(k & 1, k & 1)
        world.run(0.02)
    world.run(2.0)
    assert world.faults == []


def pulse(world: World, length: float) -> None:
    """Switches an output on for a time."""
    world.master.commit(1, world.now)
    world.run(length)
    world.master.commit(0, world.now, release=True)


def deaf(length: float) -> World:
    world = World([Channel("1.a", "can0", 5, 0, None, output_off=1, pulse=length)]).up()
    world.boards.board("can0/5")._pdos.receive = lambda cob_id, data, now: False
    return world


@pytest.mark.parametrize("length", [0.05, 0.2])
def test_a_pulse_that_a_board_does_not_follow_is_noticed_inside_the_pulse(length):
    world = deaf(length)
    pulse(world, length)
    world.run(1.0)
    assert world.codes() == ["not-switched"]


def test_pulses_that_are_too_short_to_be_read_back_are_told():
    world = World([Channel("1.a", "can0", 5, 0, None, output_off=1, pulse=0.02)], latency=0.03).up()
    for _ in range(3):
        pulse(world, 0.02)
        world.run(1.0)
        assert not world.master.committing
    assert world.faults == []
    assert "pulses are too short to be read back" in world.master.warnings()[0].message
    assert world.master.status().boards[0].unverified == 3


@pytest.mark.parametrize("answer", ["abort", "silence"])
def test_outputs_that_cannot_be_read_back_are_not_verified(answer):
    world = World([Channel("1.a", "can0", 5, 0, None)]).up()
    if answer == "abort":
        world.boards.board("can0/5").objects.refused[0x6200, 1] = 0x08000022
    else:
        world.lost = lambda bus, frame: frame.id == 0x585
    world.commit(1)
    assert world.codes() == ["not-verified"]
    assert world.master.commit_failed == world.faults[0].message
    assert world.master.status().boards[0].unverified == 3


def test_an_old_emergency_does_not_hide_another_error():
    world = World(BLIND)
    world.run(0.05)
    world.boards.board("can0/5").send_message(0x85, bytes.fromhex("2081") + bytes(6))
    world.run(0.01)
    world.up()
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x05)
    world.until(lambda: world.codes())
    assert world.codes() == ["board-error"]


def test_the_end_of_an_emergency_hides_no_error():
    world = World(BLIND).up()
    world.say(0x085, bytes(8))
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x01)
    world.until(lambda: world.codes())
    assert [(fault.code, fault.source) for fault in world.faults] == [("board-error", "can0/5")]


def test_the_boards_are_read_in_turn_and_each_from_its_first_object():
    world = World(BLIND).up()
    world.run(0.5)
    requests = [frame for frame in world.frames(sdo=True) if frame[0] & 0x780 == 0x600]
    assert requests[:4] == [
        (0x605, "40 16 10 01 00 00 00 00"),
        (0x609, "40 16 10 01 00 00 00 00"),
        (0x605, "40 17 10 00 00 00 00 00"),
        (0x609, "40 17 10 00 00 00 00 00"),
    ]


@pytest.mark.parametrize(("newest", "codes"), [(0x2320, ["board-error"]), (0x1B000000, []), (0x8130, [])])
def test_a_new_error_in_the_bits_of_a_standing_one_is_noticed_by_the_history(newest, codes):
    world = World(BLIND).up()
    board = world.master._boards.stations[0].board
    board.ignored_errors, board.history = 0x11, 0x8130
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x11)
    for sub, value in ((0, 1), (1, newest)):
        world.boards.board("can0/5").objects.set_number(0x1003, sub, value)
    world.run(10.0)
    assert world.codes() == codes
