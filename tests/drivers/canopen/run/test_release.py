"""Release: outputs go off also while boards are silent, and nothing else switches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from hyperbit.drivers.canopen.faults import Busy
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wiring import Channel
from hyperbit.drivers.simulation.variants import STANDARD
from tests.drivers.rig import World
from tests.simulation.buses.bus_model import BusModel


def pairs() -> list[Channel]:
    return [Channel(f"{node}", "can0", node, 0, None, 1, pulse=0.05) for node in (1, 2)]


def release(world: World, outputs: int) -> None:
    """Releases at each tick, as the executor does, until two heartbeats have left."""
    for _ in range(25):
        world.master.commit(outputs, world.now, release=True)
        world.run(0.01)


def lost(*nodes: int) -> World:
    """A world in which both actuators have an output on, and the boards are silent."""
    world = World(pairs()).up()
    world.master.commit(0b1001, world.now)  # the first extends, the second contracts
    world.run(0.05)
    assert world.boards.coils() == [(1, 0), (0, 1)]
    world.lost = lambda bus, frame: cia301.split(frame.id)[1] in nodes
    world.run(1.0)
    assert [fault.source for fault in world.faults] == [f"can0/{node}" for node in nodes]
    world.frames()
    return world


@pytest.mark.parametrize("nodes", [(1,), (2,), (1, 2)])
def test_outputs_go_off_on_boards_that_are_not_heard_but_hear(nodes: tuple[int, ...]) -> None:
    world = lost(*nodes)
    with pytest.raises(Busy):
        world.master.commit(0, world.now)
    world.master.commit(0, world.now, release=True)
    world.run(0.05)
    assert world.boards.coils() == [(0, 0), (0, 0)]
    assert world.master.outputs == 0


def test_a_release_of_one_board_leaves_the_other_alone() -> None:
    world = lost(2)
    world.master.commit(0b1000, world.now, release=True)
    world.run(0.05)
    assert [on for on, _ in world.boards.coils()] == [0, 0]
    assert world.master.outputs == 0b1000


def bus_lost(channels: list[Channel] | None = None) -> World:
    world = World(channels or pairs()).up()
    world.master.commit(0b1001, world.now)
    world.run(0.02)
    world.buses["can0"].go_off()
    return world


def test_outputs_go_off_as_soon_as_a_lost_bus_is_usable() -> None:
    world = bus_lost()
    world.master.commit(0, world.now, release=True)
    assert not world.master.collecting
    world.buses["can0"].restore()
    with pytest.raises(Busy, match="until its boards are booted"):
        world.master.commit(0, world.now)
    world.master.commit(0, world.now, release=True)
    world.run(0.02)
    assert world.boards.coils() == [(0, 0), (0, 0)]
    assert world.master.outputs == 0


def test_a_release_after_a_lost_bus_switches_nothing_that_was_latched_before() -> None:
    world = World(pairs()).up()
    world.commit_when_possible(1, 0, 0, 0)
    world.buses["can0"].echoes = False  # the RPDO of the second board is latched, and its SYNC is never sent
    world.run(0.02)
    world.frames()
    world.master.commit(0b0011, world.now)
    world.run(0.005)
    assert (0x202, "01") in world.frames()
    world.buses["can0"].go_off()
    world.buses["can0"].echoes = True
    world.buses["can0"].restore()
    release(world, 0b0010)
    frames = world.frames()
    assert frames.index((0x000, "80 02")) < frames.index((0x080, "")), "the other board leaves operational first"
    assert world.boards.coils() == [(0, 0), (0, 0)]


@pytest.mark.parametrize("sent", [False, True])
def test_an_output_whose_sync_is_in_doubt_goes_off_too(sent: bool) -> None:
    world = World(pairs()).up()
    world.master.commit(0b0001, world.now)
    world.until(lambda: not world.master.collecting)  # SYNC was handed out
    if not sent:
        world.buses["can0"].drop()
    world.run(0.00001)
    world.buses["can0"].go_off()
    world.run(0.02)
    assert (world.master.outputs, world.master.doubtful) == (0, 0b0001)
    world.buses["can0"].restore()
    world.master.commit(0, world.now, release=True)
    world.run(0.02)
    assert world.boards.coils() == [(0, 0), (0, 0)]
    assert world.master.doubtful == 0


def test_outputs_of_a_ready_board_go_off_while_another_one_is_booted() -> None:
    world = lost(2)
    world.lost = lambda bus, frame: cia301.split(frame.id)[1] == 2
    world.master.boot(world.now)
    world.until(lambda: world.master.known == 0b01)
    assert world.master.booting
    world.master.commit(0b1000, world.now, release=True)
    world.run(0.02)
    assert world.boards.coils()[0] == (0, 0)


@pytest.mark.parametrize("shared", [False, True])
def test_a_release_during_the_boot_of_another_board_sends_no_frame_and_keeps_all_other_outputs(shared: bool) -> None:
    slow = replace(STANDARD, answer_delay=0.02)
    plain = [Channel("plain 1", "can0", 1, 5, None), Channel("plain 2", "can0", 2, 5, None)]
    world = World([*pairs(), *plain], variants={"can0/2": slow}, shared_rpdo=shared).up()
    world.master.commit(0b01101, world.now)
    world.run(0.05)
    world.new_master()
    world.master.boot(world.now)
    world.until(lambda: world.master.known & 1)
    assert world.master.booting
    world.frames()
    world.master.commit(0b00100, world.now, release=True)
    world.run(0.1)
    assert (world.frames(), world.boards.coils()) == ([], [(0, 0), (0, 0), (1, 0), (1, 0)])
    assert [lines for lines, _ in world.switched if lines == 1] == [1]
    world.until(lambda: not world.master.booting)
    assert (world.master.boot_faults, world.master.outputs) == ([], 0b01100)


def test_a_board_that_lost_its_bus_in_a_stage_keeps_the_outputs_that_the_sync_may_have_switched() -> None:
    world = World([*pairs(), Channel("plain", "can0", 1, 5, None)]).up()
    world.master.commit(0b00101, world.now)
    world.until(lambda: not world.master.collecting)  # SYNC was handed out
    world.buses["can0"].go_off()
    world.run(0.02)
    assert world.master.doubtful == 0b00101
    world.buses["can0"].restore()
    for _ in range(40):
        world.master.commit((world.master.outputs | world.master.doubtful) & ~1, world.now, release=True)
        world.run(0.01)
    assert world.boards.coils() == [(0, 0), (0, 0), (1, 0)]


def test_a_release_switches_nothing_on_at_a_board_that_has_restarted() -> None:
    world = World([*pairs(), Channel("plain", "can0", 1, 5, None)]).up()
    world.master.commit(0b00101, world.now)
    world.run(0.05)
    world.cycle_power("can0/1")
    world.run(0.1)
    assert world.told() == ["board-rebooted"]
    world.frames()
    world.master.commit(0b00100, world.now, release=True)
    world.run(0.05)
    assert world.frames() == []
    assert not world.master.committing


def test_a_release_that_waits_for_its_echo_is_not_sent_again_at_each_tick() -> None:
    world = bus_lost()
    world.buses["can0"].restore()
    world.frames()
    world.buses["can0"].stuck = True
    for _ in range(5):
        world.master.commit(0, world.now, release=True)
        world.run(0.01)
    world.buses["can0"].stuck = False
    world.run(0.05)
    assert [cob_id for cob_id, _ in world.frames()] == [0x201, 0x202, 0x080]


def test_a_release_whose_frames_the_controller_has_dropped_is_sent_again_at_its_restart() -> None:
    world = bus_lost()
    world.buses["can0"].restore()
    world.buses["can0"].stuck = True  # nothing is echoed
    world.master.commit(0, world.now, release=True)
    world.buses["can0"].restart()
    world.buses["can0"].stuck = False
    world.frames()
    release(world, 0)
    frames = [frame for frame in world.frames() if frame[0] in (0x201, 0x80)]
    assert frames[-2:] == [(0x201, "00"), (0x80, "")]
    assert world.boards.coils() == [(0, 0), (0, 0)]


def test_frames_that_are_neither_sent_nor_lost_hold_nothing_up_for_ever() -> None:
    world = bus_lost()  # so that a bus that sends nothing is not lost once more
    world.buses["can0"].restore()
    world.run(0.05)
    world.buses["can0"].at_next_sync(lambda: setattr(world.buses["can0"], "stuck", True))
    release(world, 0)
    world.run(1.0)
    assert not world.master.leaving
    world.buses["can0"].stuck = False
    world.buses["can0"].drop()
    release(world, 0)
    assert world.boards.coils() == [(0, 0), (0, 0)]


def on_two_buses() -> World:
    world = World([Channel(bus, bus, 1, 0, None, 1, pulse=0.05) for bus in ("can0", "can1")]).up()
    world.master.commit(0b0011, world.now)
    world.run(0.02)
    assert world.boards.coils() == [(1, 0), (1, 0)]
    return world


def test_outputs_of_a_bus_go_off_while_frames_of_another_bus_are_not_sent() -> None:
    world = on_two_buses()
    world.buses["can1"].stuck = True
    for _ in range(2):
        world.master.commit(0, world.now, release=True)
        world.run(0.01)
    assert world.boards.coils() == [(0, 0), (1, 0)]
    world.buses["can1"].restore()
    for _ in range(3):
        world.master.commit(0, world.now, release=True)
        world.run(0.01)
    assert world.boards.coils() == [(0, 0), (0, 0)]
    assert world.master.outputs == 0


@pytest.mark.parametrize("lose", [BusModel.go_down, BusModel.go_off])
def test_outputs_of_a_bus_go_off_while_another_bus_is_lost(lose: Callable[[BusModel], None]) -> None:
    world = on_two_buses()
    lose(world.buses["can1"])
    world.master.commit(0, world.now, release=True)
    world.run(0.01)
    assert world.boards.coils() == [(0, 0), (1, 0)]
    assert world.master.outputs == 0b0010


def test_a_stage_under_way_that_switches_the_outputs_off_is_not_given_up_for_a_release() -> None:
    world = World(pairs()).up()
    world.master.commit(0b0001, world.now)
    world.run(0.02)
    world.master.commit(0b0010, world.now)  # ends the pulse of the first board, and begins one of the second
    world.master.commit(0, world.now, release=True)
    world.run(0.005)
    assert (world.boards.coils(), world.master.commit_failed) == ([(0, 0), (1, 0)], None)


@pytest.mark.parametrize(("stage", "after"), [(0b0011, 0.0), (0b0010, 0.02)])
def test_a_stage_is_given_up_for_a_release_if_it_keeps_the_outputs_on_or_waits_for_long(
    stage: int, after: float
) -> None:
    world = World(pairs()).up()
    world.master.commit(0b0001, world.now)
    world.run(0.02)
    world.buses["can0"].stuck = True
    world.master.commit(stage, world.now)
    world.run(after)
    world.master.commit(0, world.now, release=True)
    assert world.master.commit_failed == "an output had to be switched off first"
