"""Commits: exact frames, written as COB-ID and data, their order on several buses, and what becomes of lost ones."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.boards.outputs import Key, OutputLines
from hyperbit.drivers.canopen.faults import Busy
from hyperbit.drivers.canopen.layout import lay_out
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, NodeWiring, Timing, Wiring
from tests.drivers.rig import World, bits, two_boards, two_buses

SYNC = (0x080, "")
BEAT = (0x77F, b"\x05")


def test_a_commit_sends_the_rpdos_that_change_then_one_sync() -> None:
    world = World(two_boards()).up()
    world.commit(1, 1, then=0.1)
    assert world.frames() == [(0x205, "01"), (0x209, "08"), SYNC, (0x185, "01"), (0x189, "04")]
    assert world.measured() == [1, 1]
    world.commit(1, 0, then=0.1)
    assert world.frames() == [(0x209, "00"), SYNC, (0x189, "00")]
    assert [mask for mask, _ in world.switched] == [0b11, 0b10]
    world.commit(1, 0)
    world.master.status()
    world.run(0.1)
    assert world.frames() == [], "nothing has changed"


def test_the_first_sync_comes_after_frames_to_all_boards() -> None:
    world = World(two_boards()).up()
    world.say(0x209, b"\x08")  # an RPDO of a master that died before its SYNC
    world.run(0.01)
    world.frames()
    world.commit(1, 0, then=0.1)
    assert world.frames() == [(0x205, "01"), (0x209, "00"), SYNC, (0x185, "01")]
    assert world.switches() == [1, 0]


def test_more_than_eight_outputs_on_a_board() -> None:
    places = [(0, 1), (3, 0), (8, 13), (17, 9), (63, 63)]
    world = World([Channel(f"{o}", "can0", 3, o, i) for o, i in places]).up()
    world.commit(1, 0, 1, 0, 1, then=0.1)
    assert world.frames()[:2] == [(0x203, "01 01 00 80"), SYNC], "sub-indices 1, 2, 3 and 8"
    assert world.measured() == [1, 0, 1, 0, 1]
    world.commit(0, 1, 0, 1, 0, then=0.1)
    assert world.measured() == world.positions() == [0, 1, 0, 1, 0]


def test_shared_frames_hold_eight_bytes_and_no_board_is_in_two() -> None:
    channels = [Channel(f"{n}.{o}", "can0", n, o, o) for n in (1, 2, 3) for o in (0, 8, 16)]
    world = World(channels, shared_rpdo=True).up()
    world.commit(*[1] * 9)
    assert world.frames()[:3] == [(0x201, "01 01 01 01 01 01"), (0x203, "01 01 01"), SYNC]
    world = World(two_boards(), shared_rpdo=True).up()
    world.commit(1, 1, then=0.1)
    assert world.frames() == [(0x205, "01 08"), SYNC, (0x185, "01"), (0x189, "04")]
    world.commit(0, 1, then=0.1)
    assert world.frames() == [(0x205, "00 08"), SYNC, (0x185, "00")]


def test_sync_waits_for_the_rpdos_of_all_buses() -> None:
    world = World(two_buses()).up()
    world.frames("can1")
    world.buses["can1"].stuck = True
    world.master.commit(0b11, world.now)
    world.run(0.02)
    assert (world.frames(), world.frames("can1")) == ([(0x205, "01")], [])
    assert (world.master.switching.under_way, world.master.outputs.commanded) == (True, 0)
    world.buses["can1"].restore()
    world.run(0.1)
    assert world.frames()[0] == SYNC
    assert world.frames("can1")[:2] == [(0x205, "01"), SYNC]
    assert world.measured() == [1, 1]


def test_the_heartbeat_is_sent_by_ticks_only_and_in_time() -> None:
    world = World(timing=Timing(heartbeat=0.02, heartbeat_timeout=1.0)).up()
    log = world.buses["can0"].log
    log.clear()
    world.run(0.2)
    assert [frame for frame in world.buses["can0"].log if frame.id == BEAT[0]] == [BEAT] * 10
    world.stalled = True
    world.beats.clear()
    for _ in range(100):
        world.say(0x300, b"\x01")
    world.run(0.1)
    assert world.beats == []


@pytest.mark.parametrize("room", [0, 1])
def test_a_full_bus_gets_no_sync_and_later_the_latest_states_only(room: int) -> None:
    world = World(two_boards()).up()
    world.commit(0, 1, then=0.1)
    world.frames()
    world.buses["can0"].room = room
    world.commit(1, 0)
    assert "not sent" in world.master.switching.failed
    assert SYNC not in world.frames()
    world.buses["can0"].room = None
    world.commit_when_possible(1, 1)
    world.run(0.1)
    frames = world.frames()
    assert (0x209, "00") not in frames
    assert (frames.count(SYNC), world.switches()) == (1, [1, 1])
    assert world.master.status().buses[0].dropped > 0


def test_a_sync_that_fails_on_one_bus_is_sent_with_the_next_commit() -> None:
    world = World(two_buses()).up()
    world.buses["can1"].room = 1
    world.commit(1, 1)
    assert "SYNC" in world.master.switching.failed
    assert [mask for mask, _ in world.switched] == [0b01]
    world.buses["can1"].room = None
    world.run(0.1)
    assert (world.measured(), world.faults) == ([1, 0], [])
    for bus in ("can0", "can1"):
        world.frames(bus)
    world.commit(1, 1, then=0.1)
    assert (world.frames("can0"), world.frames("can1")) == ([], [SYNC, (0x185, "01")])
    assert world.master.outputs.commanded == 0b11


def test_a_commit_back_to_the_old_states_overwrites_what_is_latched() -> None:
    world = World(two_boards()).up()
    world.commit(1, 1, then=0.1)
    world.buses["can0"].room = 1
    world.commit(0, 0)
    assert world.master.switching.failed
    world.buses["can0"].room = None
    world.run(0.01)
    world.frames()
    world.commit(1, 1, then=0.01)
    assert world.frames()[-3:] == [(0x205, "01"), (0x209, "08"), SYNC]
    assert world.switches() == [1, 1]


def test_a_commit_before_boot_during_another_or_of_other_lines_is_refused() -> None:
    world = World()
    with pytest.raises(Busy, match="booted"):
        world.master.commit(1, world.now)
    world.run(0.1)
    assert world.frames() == []
    world.up()
    for states in (-1, 4):
        with pytest.raises(ValueError, match="2 lines"):
            world.master.commit(states, world.now)
    world.master.commit(1, world.now)
    with pytest.raises(Busy, match="not sent yet"):
        world.master.commit(2, world.now)


def test_no_sync_follows_a_stall_of_the_loop() -> None:
    world = World().up()
    world.master.commit(1, world.now)
    world.stall(0.2)
    assert not world.master.switching.under_way
    assert "halted" in world.master.switching.failed or "not sent" in world.master.switching.failed
    world.run(0.1)
    assert SYNC not in world.frames()
    assert world.faults == []


def test_a_commit_whose_bus_is_lost_names_it() -> None:
    world = World(two_buses()).up()
    world.buses["can1"].stuck = True
    world.master.commit(bits(1, 1), world.now)
    world.run(0.005)
    assert world.master.switching.collecting
    world.buses["can1"].go_off()
    assert (world.master.switching.failed, world.master.switching.under_way) == ("can1 was lost", False)


# Lines of actuators: pairs of outputs, inverted ones, both end-stops.


def test_a_pair_of_outputs_changes_in_one_frame_and_never_both_on() -> None:
    world = World([Channel("a", "can0", 5, 0, 0, output_off=1, input_contracted=1)]).up()
    assert world.master.inputs.ends == 0b10, "it is at its contracted end"
    world.commit(1, 0, then=0.01)
    assert world.master.inputs.ends == 0b00, "it is in mid-stroke"
    world.run(0.1)
    assert (world.positions(), world.master.inputs.ends) == ([1.0], 0b01)
    world.frames()
    world.commit(0, 1)
    assert world.frames()[:2] == [(0x205, "02"), SYNC], "one frame, one SYNC"
    world.run(0.1)
    assert (world.positions(), world.master.inputs.ends) == ([0.0], 0b10)
    world.commit(0, 0, then=0.1)
    assert (world.positions(), world.coils(), world.boards.both_on()) == ([0.0], [(0, 0)], [0])
    assert world.faults == []


def test_inverted_lines_are_levels_above_the_driver() -> None:
    inverted = frozenset({"output", "input", "input_contracted"})
    world = World([Channel("a", "can0", 5, 0, 0, input_contracted=1, inverted=inverted)]).up()
    assert world.positions() == [1.0], "it rests extended while its output is 0"
    assert (world.master.outputs.commanded, world.master.inputs.ends) == (0b1, 0b01)
    world.commit(0, then=0.1)
    assert (world.positions(), world.master.outputs.commanded, world.master.inputs.ends) == ([0.0], 0b0, 0b10)
    assert world.outputs() == 1
    world.commit(1, then=0.1)
    assert (world.positions(), world.master.inputs.ends, world.faults) == ([1.0], 0b01, [])


@pytest.mark.parametrize(
    ("fault", "ends"),
    [(("short_wires", "a"), 0b11), (("cut_wires", "a"), 0b00), (("jam", "a", 0.5), 0b00)],
    ids=lambda it: it[0] if isinstance(it, tuple) else "",
)
def test_a_broken_wire_reads_both_ends_or_none_and_half_way_neither(fault: tuple[str, ...], ends: int) -> None:
    world = World([Channel("a", "can0", 5, 0, 0, input_contracted=1)]).up()
    world.fault(*fault)
    for state in (1, 0):
        world.commit(state, then=1.0)
        assert world.master.inputs.ends == ends


# Which frames go before a SYNC, and which lines are still to be read.

FIRST, SECOND = ("can0", 0x205), ("can0", 0x209)
PULSED = 0b01


def lines(**node: bool) -> OutputLines:
    """Two boards with an output each; the first one's is pulsed."""
    channels = (Channel("5.left", "can0", 5, 0, None), Channel("9.left", "can0", 9, 0, None))
    wiring = Wiring((BusWiring("can0", "virtual", "can0"),), channels, nodes=(NodeWiring("can0", 5, **node),))
    outputs = OutputLines(lay_out(wiring), PULSED)
    switch(outputs, 0, FIRST, SECOND)
    return outputs


def latch(outputs: OutputLines, states: int, *keys: Key) -> None:
    for key in keys:
        outputs.sent(key, outputs.send(key, states), states)


def switch(outputs: OutputLines, states: int, *keys: Key) -> None:
    latch(outputs, states, *keys)
    outputs.switched("can0", states)


def test_frames_go_before_a_sync_if_they_replace_latched_bytes_or_lines_that_may_be_on() -> None:
    outputs = lines()
    assert (outputs.due(0), outputs.due(0b10)) == ({}, {"can0": [SECOND]})
    outputs.mistrust(PULSED)
    assert outputs.due(0b10) == {"can0": [FIRST, SECOND]}
    outputs = lines()
    latch(outputs, 0b01, FIRST)
    assert outputs.due(0) == {"can0": [FIRST]}


def test_the_end_of_a_pulse_is_to_be_read_also_at_a_board_that_is_not_verified() -> None:
    outputs = lines(verify=False)
    switch(outputs, PULSED, FIRST)
    assert (outputs.unread, outputs.released) == (0, 0)
    switch(outputs, 0, FIRST)
    assert outputs.released == PULSED
