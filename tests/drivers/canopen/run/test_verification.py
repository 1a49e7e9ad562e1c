"""Verification: missed switches, foreign changes and errors are read within seconds, with little of the bus."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import Channel, NodeWiring, Timing
from tests.drivers.rig import World, each_node

BLIND = [Channel("5.left", "can0", 5, 0, None), Channel("9.left", "can0", 9, 3, None)]
UNVERIFIED = (NodeWiring("can0", 5, verify=False),)
RPDO, READ_OUTPUTS = 0x205, "40 00 62 01 00 00 00 00"


def deaf_to_rpdos(world: World, count: int = 1000, only_off: bool = False) -> World:
    """Board 5 loses the next RPDOs, or those that switch everything off."""
    left = [count]

    def lost(frame: Frame) -> bool:
        if frame.id != RPDO or (only_off and any(frame.data)) or not left[0]:
            return False
        left[0] -= 1
        return True

    world.deaf = lost
    return world


def read(world: World) -> None:
    world.until(lambda: not world.master.outputs.unproven)


def test_boards_without_end_stops_are_read_back_at_once_after_each_switch() -> None:
    world = World(BLIND).up()
    for states in ((1, 1), (0, 1)):
        world.commit(*states)
        assert world.master.outputs.unproven == world.switched[-1][0]
        read(world)
        assert world.measured() == list(states)
    frames = world.frames(sdo=True)
    assert frames[:3] == [(RPDO, "01"), (0x209, "08"), (0x080, "")]
    assert {(0x605, READ_OUTPUTS), (0x609, READ_OUTPUTS)} <= set(frames)
    world = World(BLIND, nodes=UNVERIFIED).up()
    world.commit(1, 1)
    assert world.master.outputs.unproven == 0b10, "not of a board that is not verified"


def test_a_board_that_does_not_follow_stays_unread_until_it_is_a_fault() -> None:
    world = World(BLIND).up()
    world.objects.set_number(0x1005, 0, 0x85)  # just after the boot
    world.commit(1, 1)
    while not world.faults:
        assert world.master.outputs.unproven & 0b01
        world.run(0.001)
    [fault] = world.faults
    text = "can0/5 has 00h in 6200h sub 1 (outputs); 01h was switched: it does not follow RPDO and SYNC"
    assert (fault.code, text in fault.message) == ("not-switched", True)
    assert world.measured() == [-1, 1]
    world.up()  # a reset configures the board again
    assert world.measured() == [0, 1]


def test_a_board_that_follows_each_switch_late_is_no_fault() -> None:
    world = deaf_to_rpdos(World(BLIND).up())
    for states in ((1, 1), (0, 1), (1, 1)):
        world.commit(*states)
        world.run(0.25)  # five wrong reads; the eighth in a row is a fault
        world.objects.set_number(0x6200, 1, states[0])
        read(world)
    assert world.told() == []


@pytest.mark.parametrize(("newest", "told"), [(0x2320, ["board-error"]), (0x1B000000, []), (0x8130, [])])
def test_a_new_error_in_the_bits_of_a_standing_one_is_noticed_by_the_history(newest: int, told: list[str]) -> None:
    """The loss of the last master stands, and is no fault."""
    world = World(variant="kept-loss").up()
    world.run(0.5)
    world.lose_master()
    world.up()
    assert (world.objects.number(0x1001), world.objects.number(0x1003, 1)) == (0x11, 0x8130)
    world.objects.set_number(0x1003, 1, newest)
    world.run(10.0)
    assert world.told() == told


@pytest.mark.parametrize("answer", ["abort", "silence"])
def test_outputs_that_cannot_be_read_back_are_not_verified(answer: str) -> None:
    world = World([Channel("1.a", "can0", 5, 0, None)]).up()
    if answer == "abort":
        world.objects.refused[0x6200, 1] = 0x08000022
    else:
        world.lose(0x585)
    world.commit(1)
    assert world.next_told() == ["not-verified"]
    assert world.master.status().boards[0].unverified == 3


def test_a_silent_board_is_lost_however_long_its_heartbeats_are_awaited() -> None:
    world = World(BLIND, Timing(heartbeat_timeout=5.0)).up()
    world.fault("silence", "can0/5")
    world.commit(1, 1)
    assert world.next_told() == ["board-lost"]


def test_reading_in_turn_begins_with_the_first_object_and_takes_little_of_the_bus() -> None:
    world = World(BLIND).up()
    world.run(0.5)
    assert [frame for frame in world.frames(sdo=True) if frame[0] & 0x780 == 0x600][:4] == [
        (0x605, "40 16 10 01 00 00 00 00"),
        (0x609, "40 16 10 01 00 00 00 00"),
        (0x605, "40 17 10 00 00 00 00 00"),
        (0x609, "40 17 10 00 00 00 00 00"),
    ]
    world = World(each_node(20, end_stop=False), bitrate=125_000).up()
    world.run(1.0)
    world.frames()
    world.run(10.0)
    requests = [frame for frame in world.frames(sdo=True) if frame[0] & 0x780 == 0x600]
    assert 20 < len(requests) < 60  # two frames of at most 135 bits each: less than 1.3 % of 125 kbit/s
    assert world.faults == []


# Pulses.


def pulsed(length: float = 0.05, latency: float = 0.001, **options: object) -> World:
    return World([Channel("1.a", "can0", 5, 0, None, output_off=1, pulse=length)], latency=latency, **options).up()


def pulse(world: World, length: float, then: float = 0.0) -> None:
    world.master.commit(1, world.now)
    world.run(length)
    world.master.release(-1, world.now)
    world.run(then)


@pytest.mark.parametrize("length", [0.05, 0.2])
def test_a_pulse_that_a_board_does_not_follow_is_noticed_inside_the_pulse(length: float) -> None:
    world = pulsed(length)
    world.objects.set_number(0x1005, 0, 0x85)
    pulse(world, length, then=1.0)
    assert (world.told(), world.master.outputs.drain_missed()) == (["not-switched"], 0b01)


@pytest.mark.parametrize("late", [False, True])
def test_a_pulse_that_was_read_back_is_not_missed_also_if_the_board_follows_late(late: bool) -> None:
    world = deaf_to_rpdos(pulsed(), count=late)
    world.master.commit(1, world.now)
    world.frames()
    if late:
        world.until(lambda: (0x585, "4f 00 62 01 00 00 00 00") in world.frames(sdo=True))
        world.objects.set_number(0x6200, 1, 1)
    read(world)
    world.master.release(-1, world.now)
    world.until(lambda: not world.master.outputs.released)
    assert (world.told(), world.master.outputs.drain_missed()) == ([], 0)


def test_a_pulse_is_read_back_while_errors_are_read() -> None:
    world = pulsed()
    for sub in range(1, 9):
        world.objects.set_number(0x1003, sub, 0x8130)
    world.objects.set_number(0x1003, 0, 8)
    for states in (0b01, 0b10) * 5:
        world.master.errors.ask(0)
        world.run(0.001)
        for outputs, then in ((states, 0.05), (0, 0.5)):
            world.master.commit(outputs, world.now)
            world.until(lambda: not world.master.switching.under_way)
            world.run(then)
        assert world.master.outputs.drain_missed() == 0
        assert [len(found.history) for _, found in world.master.errors.drain()] == [8]


def test_a_coil_that_another_program_has_switched_on_leaves_the_state_unknown() -> None:
    world = pulsed()
    world.run(1.0)
    world.objects.set_number(0x6200, 1, 0x02)
    world.until(lambda: world.master.outputs.doubtful)
    assert world.master.outputs.drain_missed() == 0b10


def test_a_board_that_is_unplugged_in_its_third_short_pulse_is_lost_and_nobody_advises_longer_pulses() -> None:
    world = pulsed(0.02, latency=0.03)
    world.run(2.0)  # its outputs were read
    for k in range(3):
        world.board().silent = k == 2
        pulse(world, 0.02, then=0.01)
        assert world.master.outputs.drain_missed() == 0b01
        world.run(1.0)
    assert world.told() == ["board-lost"]


def test_pulses_of_a_board_that_is_not_verified_are_not_missed() -> None:
    world = pulsed(0.02, latency=0.03, nodes=UNVERIFIED)
    for _ in range(4):
        pulse(world, 0.02, then=1.0)
        assert world.master.outputs.drain_missed() == 0
    assert world.faults == []


@pytest.mark.parametrize("times", [1, 3])
def test_the_end_of_a_pulse_that_a_board_has_lost_is_sent_until_it_is_read_off(times: int) -> None:
    world = deaf_to_rpdos(pulsed(), times, only_off=True)
    pulse(world, 0.05)
    assert world.master.outputs.released == 0
    world.run(0.01)
    assert world.coils() == [(1, 0)]
    world.release(ticks=60)
    assert (world.coils(), world.master.outputs.released, world.master.outputs.doubtful) == ([(0, 0)], 0, 0)
    assert world.faults == []


def test_the_end_of_a_pulse_is_sent_until_it_is_read_off_also_to_a_board_that_is_not_ready() -> None:
    world = deaf_to_rpdos(pulsed(), 2, only_off=True)
    pulse(world, 0.05)
    world.lose(0x705, 0x585)  # it hears, and is not heard
    world.release(ticks=100)
    assert (world.told()[0], world.coils()) == ("board-lost", [(0, 0)])
    assert world.master.outputs.released | world.master.outputs.doubtful == 0b01, "nobody has told so"
    world.lose()
    world.release(ticks=50)
    assert world.master.outputs.released | world.master.outputs.doubtful == 0
