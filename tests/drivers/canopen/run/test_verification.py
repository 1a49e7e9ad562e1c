"""Verification: missed switches and foreign changes are found within two seconds."""

from __future__ import annotations

from typing import Any

import pytest

from hyperbit.drivers.canopen.wiring import Channel, NodeWiring, Timing
from tests.drivers.rig import World

BLIND = [Channel("5.left", "can0", 5, 0, None), Channel("9.left", "can0", 9, 3, None)]


def sdo(world: World, index: int, sub: int, value: int, size: int) -> None:
    board = world.boards.board("can0/5").objects
    board.set_data(index, sub, value.to_bytes(size, "little"))


def test_boards_without_end_stops_are_read_back_at_once_after_each_switch():
    world = World(BLIND).up()
    for states in ((1, 1), (0, 1)):
        world.commit(*states)
        assert world.master.unread == world.switched[-1][0]
        world.until(lambda: not world.master.unread)
        assert world.measured() == list(states)
    frames = world.frames(sdo=True)
    assert frames[:3] == [(0x205, "01"), (0x209, "08"), (0x080, "")]
    assert {(0x605, "40 00 62 01 00 00 00 00"), (0x609, "40 00 62 01 00 00 00 00")} <= set(frames)


def test_a_board_that_is_not_verified_is_not_unread():
    world = World(BLIND, nodes=(NodeWiring("can0", 5, verify=False),)).up()
    world.commit(1, 1)
    assert world.master.unread == 0b10


def test_a_board_that_does_not_follow_stays_unread_until_it_is_a_fault():
    world = World(BLIND).up()
    sdo(world, 0x1005, 0, 0x85, 4)  # just after the boot
    world.commit(1, 1)
    while not world.faults:
        assert world.master.unread & 0b01
        world.run(0.001)
    assert world.told() == ["not-switched"]
    text = "can0/5 has 00h in 6200h sub 1 (outputs); 01h was switched: it does not follow RPDO and SYNC"
    assert text in world.faults[0].message
    assert world.measured() == [-1, 1]
    world.up()  # a reset configures the board again
    assert world.measured() == [0, 1]


def test_a_board_that_follows_each_switch_late_is_no_fault():
    world = World(BLIND).up()
    world.boards.board("can0/5").pdos.receive = lambda cob_id, data, now: True
    for states in ((1, 1), (0, 1), (1, 1)):
        world.commit(*states)
        world.run(0.25)  # five wrong reads; the eighth in a row is a fault
        sdo(world, 0x6200, 1, states[0], 1)
        world.until(lambda: not world.master.unread)
    assert world.told() == []


@pytest.mark.parametrize("end_stop", [None, 0])
def test_a_board_that_stops_switching_later_is_noticed_within_two_seconds(end_stop):
    world = World([Channel("5.left", "can0", 5, 0, end_stop)]).up()
    world.commit(1, then=0.5)
    sdo(world, 0x1005, 0, 0x85, 4)
    world.commit(0)
    assert world.until(lambda: world.told()) < 2
    assert world.told() == ["not-switched"]


def test_another_program_that_switches_an_output_is_noticed():
    world = World(BLIND).up()
    world.commit(1, 1, then=0.5)
    sdo(world, 0x6200, 1, 0x00, 1)
    assert world.until(lambda: world.told()) < 2
    assert world.told() == ["not-switched"]


@pytest.mark.parametrize(
    ("index", "sub", "value", "size"),
    [(0x1005, 0, 0x85, 4), (0x1400, 2, 255, 1), (0x1016, 1, 0, 4), (0x6206, 1, 0xFF, 1), (0x1029, 1, 1, 1)],
)
def test_another_program_that_changes_a_board_is_noticed(index, sub, value, size):
    world = World(BLIND).up()
    sdo(world, index, sub, value, size)
    assert world.until(lambda: world.told()) < 10
    assert world.told() == ["board-changed"]
    assert f"can0/5 has {value:0{2 * size}X}h in {index:04X}h sub {sub}" in world.faults[0].message
    world.up()
    world.run(5)
    assert world.told() == ["board-changed"]


def test_an_error_of_which_no_emergency_was_heard_is_noticed():
    world = World(BLIND).up()
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x09)
    assert world.next_told() == ["board-error"]
    assert "1001h sub 0 is 09h" in world.faults[0].message


def test_reading_back_takes_little_of_the_bus():
    world = World([Channel(f"{n}", "can0", n, 0, None) for n in range(1, 21)], bitrate=125_000).up()
    world.run(1.0)
    world.frames(sdo=True)
    world.run(10.0)
    requests = [frame for frame in world.frames(sdo=True) if frame[0] & 0x780 == 0x600]
    assert 20 < len(requests) < 60  # two frames of at most 135 bits each: less than 1.3 % of 125 kbit/s
    assert world.faults == []


def pulse(world: World, length: float) -> None:
    world.master.commit(1, world.now)
    world.run(length)
    world.master.commit(0, world.now, release=True)


def pulsed(length: float, latency: float = 0.001, **options: Any) -> World:
    return World([Channel("1.a", "can0", 5, 0, None, output_off=1, pulse=length)], latency=latency, **options).up()


@pytest.mark.parametrize("length", [0.05, 0.2])
def test_a_pulse_that_a_board_does_not_follow_is_noticed_inside_the_pulse(length):
    world = pulsed(length)
    world.boards.board("can0/5").pdos.receive = lambda cob_id, data, now: False
    pulse(world, length)
    world.run(1.0)
    assert world.told() == ["not-switched"]
    assert world.master.drain_missed() == 0b01


def test_a_pulse_that_was_read_back_is_not_missed():
    world = pulsed(0.05)
    world.master.commit(1, world.now)
    world.until(lambda: not world.master.unread)
    world.master.commit(0, world.now, release=True)
    world.until(lambda: not world.master.released)
    assert world.master.drain_missed() == 0


def test_a_pulse_that_a_board_follows_late_is_no_fault():
    world = pulsed(0.05)
    world.boards.board("can0/5").pdos.receive = lambda cob_id, data, now: True
    world.master.commit(1, world.now)
    world.frames()
    world.until(lambda: (0x585, "4f 00 62 01 00 00 00 00") in world.frames(sdo=True))
    sdo(world, 0x6200, 1, 1, 1)
    world.until(lambda: not world.master.unread)
    assert world.told() == []


def test_a_coil_that_another_program_has_switched_on_leaves_the_state_unknown():
    world = pulsed(0.05)
    world.run(1.0)
    sdo(world, 0x6200, 1, 0x02, 1)
    world.until(lambda: world.master.doubtful)
    assert world.master.drain_missed() == 0b10


def test_pulses_that_are_over_before_they_are_read_are_missed_and_the_third_is_a_fault():
    world = pulsed(0.02, latency=0.03)
    for k in range(3):
        pulse(world, 0.02)
        world.run(1.0)
        assert world.master.unread == 0b01
        assert not world.master.committing
        assert world.told() == []
        assert world.master.drain_missed() == 0b01
        assert world.master.status().boards[0].unverified == k + 1
    world.until(world.told)
    assert world.told() == ["not-verified"]
    assert "verify: false in boards.nodes" in world.faults[0].message


def test_a_board_that_is_unplugged_in_its_third_short_pulse_is_lost_and_nobody_advises_longer_pulses():
    world = pulsed(0.02, latency=0.03)
    world.run(2.0)  # its outputs were read
    for k in range(3):
        world.boards.board("can0/5").silent = k == 2
        pulse(world, 0.02)
        world.run(0.01)
        assert world.master.drain_missed() == 0b01
        world.run(1.0)
    assert world.told() == ["board-lost"]


def test_pulses_of_a_board_that_is_not_verified_are_not_missed():
    world = pulsed(0.02, latency=0.03, nodes=(NodeWiring("can0", 5, verify=False),))
    for _ in range(4):
        pulse(world, 0.02)
        world.run(1.0)
        assert world.master.drain_missed() == 0
    assert world.faults == []


def loses(world: World, times: int) -> None:
    """The board loses the next RPDOs that switch everything off."""
    pdos, left = world.boards.board("can0/5").pdos, [times]
    receive = pdos.receive

    def lossy(cob_id: int, data: bytes, now: float) -> bool:
        if cob_id == 0x205 and not any(data) and left[0]:
            left[0] -= 1
            return True
        return bool(receive(cob_id, data, now))

    pdos.receive = lossy


@pytest.mark.parametrize("times", [1, 3])
def test_the_end_of_a_pulse_that_a_board_has_lost_is_sent_until_it_is_read_off(times):
    world = pulsed(0.05)
    loses(world, times)
    pulse(world, 0.05)
    assert world.master.released == 0
    world.run(0.01)
    assert world.boards.coils() == [(1, 0)]
    for _ in range(60):
        world.master.commit(0, world.now, release=True)
        world.run(0.01)
    assert world.boards.coils() == [(0, 0)]
    assert (world.master.released, world.master.doubtful) == (0, 0)
    assert world.faults == []


def test_the_end_of_a_pulse_is_sent_until_it_is_read_off_also_to_a_board_that_is_not_ready():
    world = pulsed(0.05)
    loses(world, 2)
    pulse(world, 0.05)
    world.lost = lambda bus, frame: frame.id in (0x705, 0x585)  # it hears, and is not heard
    for _ in range(100):
        world.master.commit(0, world.now, release=True)
        world.run(0.01)
    assert world.told()[0] == "board-lost"
    assert world.boards.coils() == [(0, 0)]
    assert world.master.released | world.master.doubtful == 0b01  # nobody has told so
    world.lost = lambda bus, frame: False
    for _ in range(50):
        world.master.commit(0, world.now, release=True)
        world.run(0.01)
    assert world.master.released | world.master.doubtful == 0


@pytest.mark.parametrize("answer", ["abort", "silence"])
def test_outputs_that_cannot_be_read_back_are_not_verified(answer):
    world = World([Channel("1.a", "can0", 5, 0, None)]).up()
    if answer == "abort":
        world.boards.board("can0/5").objects.refused[0x6200, 1] = 0x08000022
    else:
        world.lost = lambda bus, frame: frame.id == 0x585
    world.commit(1)
    assert world.next_told() == ["not-verified"]
    assert world.master.status().boards[0].unverified == 3


def test_a_silent_board_is_lost_however_long_its_heartbeats_are_awaited():
    world = World(BLIND, Timing(heartbeat_timeout=5.0)).up()
    world.boards.board("can0/5").silent = True
    world.commit(1, 1)
    assert world.next_told() == ["board-lost"]


def test_an_old_emergency_does_not_hide_another_error():
    world = World(BLIND)
    world.run(0.05)
    world.boards.board("can0/5").send_message(0x85, bytes.fromhex("2081") + bytes(6))
    world.run(0.01)
    world.up()
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x05)
    assert world.next_told() == ["board-error"]


def test_the_end_of_an_emergency_hides_no_error():
    world = World(BLIND).up()
    world.say(0x085, bytes(8))
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x01)
    world.until(lambda: world.told())
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
    board = world.master._boards[0]
    board.ignored_errors, board.history = 0x11, 0x8130
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x11)
    for sub, value in ((0, 1), (1, newest)):
        world.boards.board("can0/5").objects.set_number(0x1003, sub, value)
    world.run(10.0)
    assert world.told() == codes
