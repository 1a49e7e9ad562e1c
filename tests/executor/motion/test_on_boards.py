"""The executor on simulated boards: supplies, lost frames, errors that waited, and travel times."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from hyperbit.controller.executor.arm.kinds import Ends
from hyperbit.controller.executor.motion.readings import TravelTimes
from hyperbit.controller.program import (
    Answer,
    BoardErrors,
    Diagnostics,
    Ended,
    ReadErrors,
    Reset,
    Snapshot,
    Travel,
    unpack,
)
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import BoardId, Interlock, WatchedObject
from hyperbit.drivers.simulation.buses import LEAST_PULSE
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS
from tests.executor.rig import ALL, STEP, A, B, World, ready_world

SUPPLY = Interlock("supply", "can0", 2, 0, watched=WatchedObject(0x2102, 0))
BISTABLE: dict[str, Any] = {"output_off": True, "pulse": 0.05}
BOTH = {"input_contracted": True}


@pytest.mark.parametrize(
    ("variant", "channel", "lost"),
    [
        ("valve-supply", {}, "moving"),
        ("valve-supply", BISTABLE, "at the boot"),
        ("mapped-supply", BISTABLE, "moving"),
        ("mapped-supply", {}, "at rest"),
    ],
)
def test_a_supply_that_returns_moves_nothing_before_reset_and_a_goal(
    variant: str, channel: dict[str, Any], lost: str
) -> None:
    world = World({"can0/2": VARIANTS[variant]}, interlocks=(SUPPLY,), channel=channel)
    if lost == "at the boot":
        world.fault("open", "supply")
    world.go(2.0)
    if lost != "at the boot":
        world.run(A, B, A, B, step=0.4)
        world.go(0.3 if lost == "moving" else 3.0)
        world.fault("open", "supply")
        world.go(1.0)
    assert world.mode == "fault"
    assert "interlock supply (can0/2 2102h sub 0 bit 0) is open" in world.snapshot.reason
    begun = len(world.syncs), world.boards.switches()
    assert lost != "moving" or begun[0] <= (4 if channel else 2), "no further stage begins"
    world.send(Reset(1, world.epoch))
    world.go(1.0)
    assert not world.last(Answer).accepted
    world.fault("close", "supply")
    world.go(3.0)
    assert (world.mode, len(world.syncs), world.boards.switches()) == ("fault", *begun)
    world.send(Reset(2, world.epoch))
    world.go(1.0)
    assert (world.mode, len(world.syncs), world.boards.switches()) == ("ready", *begun)
    world.run(A)
    world.go(2.0)
    assert (world.last(Ended).status, world.positions) == ("done", A)


def test_a_board_that_comes_back_without_the_object_of_an_interlock_stays_refused() -> None:
    world = ready_world(variants={"can0/2": VARIANTS["valve-supply"]}, interlocks=(SUPPLY,))
    world.boards.board("can0/2").objects.refused[SUPPLY.watched] = 0x0602_0000
    world.fault("power_cut", "can0/2")
    world.fault("power_on", "can0/2")
    world.go(1.0)
    world.send(Reset(1, world.epoch))
    world.go(4.0)
    assert world.mode == "fault"
    assert "can0/2 has no 2102h sub 0; an interlock" in world.snapshot.reason


@pytest.mark.parametrize("board", [BoardId("can0", 9), BoardId("can1", 1)], ids=str)
def test_a_lost_message_of_end_stops_is_made_good_by_a_question_to_their_board(board: BoardId) -> None:
    world = ready_world(input_board=board, channel=BOTH)
    lost: list[Frame] = []

    def lossy(bus: str, frame: Frame) -> bool:
        if (bus, frame.id) == (board.bus, 0x180 + board.node):
            lost.append(frame)
        return frame in lost

    world.lost = lossy
    world.run(A)
    world.go(1.0)
    assert lost
    assert (world.mode, world.last(Ended).status) == ("ready", "done"), world.logged
    assert unpack(world.snapshot.measured) == A


@pytest.mark.parametrize("code", ["8130", "2320", "8120"])
def test_errors_that_came_and_went_during_a_stall_are_no_fault_after_a_reset(code: str) -> None:
    world = ready_world()
    world.executor.stall(3.0)
    world.send(Reset(1, world.epoch + 1))  # of the stall's fault
    world.go(1.5)
    world.fault("error", "can0/1", code)
    world.go(1.5 - STEP)
    world.fault("error_over", "can0/1", code)
    world.go(1.0)
    assert (world.mode, world.snapshot.faults) == ("ready", ()), world.logged


def test_errors_of_a_board_are_read_in_motion_and_in_fault_and_add_none() -> None:
    world = ready_world()
    diagnostics = world.last(Diagnostics)
    assert [bus.name for bus in diagnostics.buses] == ["can0"]
    assert {board.state for board in diagnostics.boards} == {"operational"}
    world.run(A, B, A)
    world.send(ReadErrors(7, "can0/1"))
    world.go(1.0)
    assert world.last(BoardErrors) == BoardErrors(7, "", 0, ())
    assert world.last(Ended).status == "done"
    world.fault("error", "can0/1", 5000)
    world.go(0.5)
    assert world.mode == "fault"
    for request in (8, 9):
        world.send(ReadErrors(request, "can0/1"))
        world.go(0.5)
        assert world.last(BoardErrors) == BoardErrors(request, "", 0x01, (0x5000,))


def test_a_snapshot_in_which_a_board_is_unknown_tells_the_fault() -> None:
    slow = replace(STANDARD, answer_delay=0.03)
    world = ready_world(variants={"can0/1": slow}, sensed=0, channel={"output_off": True, "pulse": 0.02})
    world.run(ALL)  # each pulse is over before it is read back; the third one is a fault
    world.go(3.0)
    assert [code for code, _ in world.faults] == ["not-verified"]
    without = [told for told in world.of(Snapshot) if ALL & ~(unpack(told.known) | unpack(told.homing))]
    assert {told.mode for told in without} <= {"starting", "fault"}


def travels(world: World) -> list[tuple[int, int, float]]:
    assert world.last(Ended).status == "done"
    return [(t.actuator, t.state, t.seconds) for t in world.last(Ended).travels]


@pytest.mark.parametrize("channel", [{}, {"output_off": True}, BISTABLE])
def test_each_way_of_each_actuator_is_measured_also_by_an_executor_that_reads_late(channel: dict[str, Any]) -> None:
    contract, extend = 0.04, 0.12  # half of the greatest [s]
    world = ready_world(channel={**BOTH, **channel, "travel": (2 * contract, 2 * extend)})
    valve = LEAST_PULSE if "output_off" in channel else 0.0
    for k in range(6):
        for state, seconds in ((1, extend), (0, contract)):
            world.run(state << k)
            world.go(STEP)
            world.executor.stall(0.07 * (k == 5))
            world.go(0.5)
            assert travels(world) == [(k, state, pytest.approx(seconds + valve, rel=0.1))]


def test_slow_ways_are_measured_and_ways_to_an_end_without_end_stop_are_not() -> None:
    world = ready_world(channel={"travel": (0.1, 0.1)})
    world.fault("slow", "1.left", 1.6)
    world.run(1)
    world.go(0.5)
    assert travels(world) == [(0, 1, pytest.approx(0.08, rel=0.1))]
    world.run(0)
    world.go(0.5)
    assert travels(world) == []


def test_a_way_whose_frames_tell_no_time_is_not_measured_and_one_called_back_is_measured_anew() -> None:
    times = TravelTimes()
    for begun, ended in ((None, 2.0), (1.0, None)):
        times.begin(0b1, 0b1, Ends(0, 0b1), begun)
        assert times.drain_arrived(Ends(0b1, 0), ended) == []
        assert not any(times.travelling)
    times.begin(0b1, 0b1, Ends(0, 0b1), 1.0)
    times.begin(0b1, 0b0, Ends(0, 0), 1.1)
    assert times.drain_arrived(Ends(0, 0), 1.15) == []
    assert times.drain_arrived(Ends(0, 0b1), 1.2) == [Travel(0, 0, pytest.approx(0.1))]
    assert not any(times.travelling)


@pytest.mark.parametrize("variant", ["standard", "no-sync"])
def test_a_pulse_that_a_lost_bus_may_have_begun_ends_as_soon_as_the_bus_is_back(variant: str) -> None:
    """The board keeps the heartbeats' time-out, and the boot comes a second later."""
    world = ready_world(variants=dict.fromkeys(("can0/1", "can0/2"), VARIANTS[variant]), channel=BISTABLE)
    bus = world.buses["can0"]
    if variant == "no-sync":
        bus.echoes = False
    else:
        bus.at_next_sync(lambda: setattr(bus, "echoes", False))
    world.run(1)
    world.agenda.until(lambda: world.boards.coils()[0] == (1, 0))
    bus.go_off()
    bus.restore()
    world.go(0.05)
    assert (world.mode, world.boards.coils()[0]) == ("fault", (0, 0))
