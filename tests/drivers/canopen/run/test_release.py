"""Release: outputs go off also while boards are silent or booted or their bus is lost, and nothing else switches."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hyperbit.drivers.canopen.faults import Busy
from hyperbit.drivers.canopen.wire.cia301 import split
from hyperbit.drivers.canopen.wiring import Channel
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS
from tests.drivers.rig import World

PULSED = [Channel(f"{node}", "can0", node, 0, None, output_off=1, pulse=0.05) for node in (1, 2)]
PLAIN = [Channel(f"plain {node}", "can0", node, 5, None) for node in (1, 2)]
OFF = [(0, 0), (0, 0)]


def driven(states: int = 0b1001, plain: int = 0, **options: object) -> World:
    """Both pulses are on: the first actuator extends, the second contracts."""
    world = World([*PULSED, *PLAIN[:plain]], **options).up()
    world.master.commit(states, world.now)
    world.run(0.05)
    world.frames()
    return world


def with_lost(*nodes: int) -> World:
    """Boards hear, and are not heard."""
    world = driven()
    world.lost = lambda bus, frame: split(frame.id)[1] in nodes
    world.run(1.0)
    assert [fault.source for fault in world.faults] == [f"can0/{node}" for node in nodes]
    world.frames()
    return world


def with_lost_bus() -> World:
    world = driven()
    world.buses["can0"].go_off()
    return world


@pytest.mark.parametrize("nodes", [(1,), (2,), (1, 2)])
def test_outputs_go_off_on_boards_that_are_not_heard_but_hear_each_at_its_time(nodes: tuple[int, ...]) -> None:
    world = with_lost(*nodes)
    with pytest.raises(Busy):
        world.master.commit(0, world.now)
    for left, coils in ((0b1000, [(0, 0), (0, 1)]), (0, OFF)):
        world.release(left, ticks=5)
        assert (world.coils(), world.master.outputs.commanded) == (coils, left)


def test_a_release_after_a_lost_bus_switches_nothing_that_was_latched_before() -> None:
    world = World(PULSED).up()
    world.commit_when_possible(1, 0, 0, 0)
    world.buses["can0"].echoes = False  # the RPDO of the second board is latched, and its SYNC is never sent
    world.run(0.02)
    world.frames()
    world.master.commit(0b0011, world.now)
    world.run(0.005)
    assert (0x202, "01") in world.frames()
    world.buses["can0"].go_off()
    world.buses["can0"].restore()
    world.release(0b0010)
    frames = world.frames()
    assert frames.index((0x000, "80 02")) < frames.index((0x080, "")), "the other board leaves operational first"
    assert world.coils() == OFF


@pytest.mark.parametrize("sent", [False, True])
def test_an_output_whose_sync_is_in_doubt_goes_off_and_those_that_stay_keep_what_it_may_have_switched(
    sent: bool,
) -> None:
    world = World([*PULSED, PLAIN[0]]).up()
    world.master.commit(0b00101, world.now)
    world.until(lambda: not world.master.switching.collecting)  # SYNC was handed out
    if not sent:
        world.buses["can0"].drop()
    world.run(0.00001)
    world.buses["can0"].go_off()
    world.run(0.02)
    assert (world.master.outputs.commanded, world.master.outputs.doubtful) == (0, 0b00101)
    world.buses["can0"].restore()
    for _ in range(40):
        world.release((world.master.outputs.commanded | world.master.outputs.doubtful) & ~1, ticks=1)
    assert world.coils() == [*OFF, (1, 0)]
    assert world.master.outputs.doubtful & 0b1 == 0


def test_an_output_whose_frame_without_sync_is_in_doubt_goes_off() -> None:
    world = World(PULSED, variants={"can0/1": VARIANTS["no-sync"]}).up()
    world.master.commit(0b0001, world.now)
    world.buses["can0"].echoes = False
    world.run(0.005)
    world.buses["can0"].go_off()
    assert (world.coils()[0], world.master.outputs.commanded, world.master.outputs.doubtful) == ((1, 0), 0, 0b0001)
    world.buses["can0"].restore()
    world.release(world.master.outputs.commanded, ticks=40)
    assert (world.coils(), world.master.outputs.doubtful) == (OFF, 0)


@pytest.mark.parametrize("shared", [False, True])
def test_a_release_during_the_boot_of_another_board_sends_no_frame_and_keeps_all_other_outputs(shared: bool) -> None:
    slow = replace(STANDARD, answer_delay=0.02)
    world = driven(0b01101, plain=2, variants={"can0/2": slow}, shared_rpdo=shared)
    world.new_master()
    world.master.boot(world.now)
    world.until(lambda: world.master.inputs.known & 1)
    assert world.master.booting.under_way
    world.frames()
    world.release(0b00100, ticks=1)
    world.run(0.1)
    assert (world.frames(), world.coils()) == ([], [*OFF, (1, 0), (1, 0)])
    assert [lines for lines, _ in world.switched if lines == 1] == [1]
    world.until(lambda: not world.master.booting.under_way)
    assert (world.master.booting.faults, world.master.outputs.commanded) == ([], 0b01100)


def test_a_release_switches_nothing_on_at_a_board_that_has_restarted() -> None:
    world = driven(0b00101, plain=1)
    world.cycle_power("can0/1")
    world.run(0.1)
    assert world.told() == ["board-rebooted"]
    world.frames()
    world.release(0b00100, ticks=5)
    assert (world.frames(), world.master.switching.under_way) == ([], False)


def test_a_release_whose_frames_the_controller_has_dropped_is_sent_again_at_its_restart() -> None:
    world = with_lost_bus()
    world.buses["can0"].restore()
    world.buses["can0"].stuck = True  # nothing is echoed
    world.master.release(-1, world.now)
    world.buses["can0"].restart()
    world.buses["can0"].stuck = False
    world.frames()
    world.release()
    assert [frame for frame in world.frames() if frame[0] in (0x201, 0x80)][-2:] == [(0x201, "00"), (0x80, "")]
    assert world.coils() == OFF


def test_frames_that_are_neither_sent_nor_lost_hold_nothing_up_for_ever() -> None:
    world = with_lost_bus()  # so that a bus that sends nothing is not lost once more
    bus = world.buses["can0"]
    bus.restore()
    world.run(0.05)
    bus.at_next_sync(lambda: setattr(bus, "stuck", True))
    world.release()
    world.run(1.0)
    assert not world.master.switching.leaving
    bus.stuck = False
    bus.drop()
    world.release()
    assert world.coils() == OFF


@pytest.mark.parametrize(
    ("stage", "stuck", "after", "failed"),
    [
        (0b0010, False, 0.0, None),  # it ends the pulse of the first board, and begins one of the second
        (0b0011, True, 0.0, "an output had to be switched off first"),  # it keeps the output on
        (0b0010, True, 0.02, "an output had to be switched off first"),  # it waits for long
    ],
)
def test_a_stage_is_given_up_for_a_release_unless_it_switches_the_output_off(
    stage: int, stuck: bool, after: float, failed: str | None
) -> None:
    world = driven(0b0001)
    world.buses["can0"].stuck = stuck
    world.master.commit(stage, world.now)
    world.run(after)
    world.master.release(-1, world.now)
    assert world.master.switching.failed == failed
    world.run(0.005)
    assert stuck or world.coils() == [(0, 0), (1, 0)]
