"""Pairs of outputs, inverted outputs and inputs, both end-stops: the driver's lines on simulated actuators."""

from __future__ import annotations

from hyperbit.drivers.canopen.wiring import Channel
from tests.drivers.rig import World


def ends(world: World) -> int:
    return world.master.ends


def test_a_pair_of_outputs_changes_in_one_frame_and_never_both_on():
    world = World([Channel("a", "can0", 5, 0, 0, output_off=1, input_contracted=1)]).up()
    assert ends(world) == 0b10, "it is at its contracted end"
    world.commit(1, 0, then=0.01)
    assert ends(world) == 0b00, "it is in mid-stroke"
    world.run(0.1)
    assert (world.positions(), ends(world)) == ([1.0], 0b01)
    world.frames()
    world.commit(0, 1)
    assert world.frames()[:2] == [(0x205, "02"), (0x080, "")], "one frame, one SYNC"
    world.run(0.1)
    assert (world.positions(), ends(world)) == ([0.0], 0b10)
    world.commit(0, 0, then=0.1)
    assert (world.positions(), world.boards.coils(), world.boards.both_on()) == ([0.0], [(0, 0)], [0])
    assert world.faults == []


def test_inverted_lines_are_levels_above_the_driver():
    inverted = frozenset({"output", "input", "input_contracted"})
    world = World([Channel("a", "can0", 5, 0, 0, input_contracted=1, inverted=inverted)]).up()
    assert world.positions() == [1.0], "it rests extended while its output is 0"
    assert (world.master.outputs, ends(world)) == (0b1, 0b01)
    world.commit(0, then=0.1)
    assert (world.positions(), world.master.outputs, ends(world)) == ([0.0], 0b0, 0b10)
    assert world.boards.board("can0/5").objects.number(0x6200, 1) == 1
    world.commit(1, then=0.1)
    assert (world.positions(), ends(world)) == ([1.0], 0b01)
    assert world.faults == []


def test_a_broken_wire_reads_both_ends_or_none():
    world = World([Channel("a", "can0", 5, 0, 0, input_contracted=1)]).up()
    for broken, levels in (("short_wires", 0b11), ("cut_wires", 0b00)):
        world.fault(broken, "a")
        world.run(0.01)
        assert ends(world) == levels


def test_an_actuator_that_fails_half_way_is_at_neither_end():
    world = World([Channel("a", "can0", 5, 0, 0, input_contracted=1)]).up()
    world.fault("jam", "a", 0.5)
    world.commit(1, then=1.0)
    assert (world.positions(), ends(world)) == ([0.5], 0b00)
    world.commit(0, then=1.0)
    assert (world.positions(), ends(world)) == ([0.5], 0b00)
