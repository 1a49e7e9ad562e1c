"""The executor on the real CANopen master and simulated boards: two outputs, pulses and interlocks."""

from __future__ import annotations

import pytest

from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import TICK, Answer, Ended, Reset, Snapshot, unpack
from hyperbit.drivers.canopen.wiring import Interlock, WatchedObject
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.executor.rig import SIZE
from tests.executor.world import STEP, A, B, World, ready

ALL = (1 << SIZE) - 1
PULSE = 0.05
KINDS = {
    "two outputs": {"output_off": True},
    "two outputs, both end-stops": {"output_off": True, "input_contracted": True},
    "pulses": {"output_off": True, "pulse": PULSE},
    "pulses, both end-stops": {"output_off": True, "pulse": PULSE, "input_contracted": True},
    "all inverted but the outputs": {"input_contracted": True, "inverted": frozenset({"input", "input_contracted"})},
    "inverted outputs": {"inverted": frozenset({"output"})},
}


def positions(world: World) -> int:
    return sum(round(position) << k for k, position in enumerate(world.boards.positions()))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sensed", [0, ALL])
def test_programs_move_actuators_of_every_kind(kind: str, sensed: int) -> None:
    channel = dict(KINDS[kind])
    if not sensed:
        channel["input_contracted"] = False
    world = ready(sensed=sensed, channel=channel)
    before = world.boards.coils()
    world.run(1, A, B)
    world.go(1.0)
    assert (world.last(Ended).status, positions(world)) == ("done", B), world.logged
    assert unpack(world.last(Snapshot).known) == ALL
    assert not any(world.boards.both_on())
    if "pulse" in channel:
        assert before == world.boards.coils() == [(0, 0)] * SIZE
        assert all(PULSE - 0.005 < length <= PULSE + TICK for length in world.boards.longest_pulses() if length)


def test_a_pulse_ends_though_its_board_is_not_heard_any_more() -> None:
    world = World(sensed=0, channel={"output_off": True, "pulse": 1.0}, on_loss="hold")
    world.go(2.0)
    world.run(1, A)
    world.go(0.1)
    assert 1 in world.boards.coils()[0]
    world.fault("silence", "can0/1")
    world.go(0.9)
    assert world.mode == "fault"
    world.fault("unsilence", "can0/1")
    world.go(0.3)
    assert world.boards.coils()[0] == (0, 0)


def test_an_overdue_pulse_is_told_again_after_a_boot_that_fails_at_once() -> None:
    world = ready(sensed=0, channel=KINDS["pulses"])
    world.run(1, 0b000001)
    world.go(0.02)
    world.buses["can0"].go_down()
    world.go(0.25)
    for request in (1, 2):
        world.send(Reset(request, world.epoch))
        world.go(0.2)
        assert "pulse-overdue" in {fault.code for fault in world.last(Snapshot).faults}


@pytest.mark.parametrize("missing", [False, True])
def test_a_pulse_ends_as_soon_as_its_bus_carries_frames_again(missing: bool) -> None:
    world = ready(sensed=0, channel=KINDS["pulses"])
    world.run(1, 0b000001)
    world.go(0.02)
    assert any(1 in coils for coils in world.boards.coils())
    world.buses["can0"].go_off()
    world.go(0.25)
    overdue = [fault for fault in world.last(Snapshot).faults if fault.code == "pulse-overdue"]
    assert overdue
    assert overdue[0].source == "1.left (can0/1 output 0)"
    assert "could not be ended in time: its coil may be on" in overdue[0].message
    if missing:
        world.fault("silence", "can0/2")
    world.buses["can0"].restore()
    world.go(0.05)
    heard = world.boards.coils()[: 3 if missing else SIZE]
    assert not any(1 in coils for coils in heard)
    assert "pulse-overdue" in {fault.code for fault in world.last(Snapshot).faults}, "it was not read back yet"
    world.go(6.0)
    late = {fault.source for fault in world.last(Snapshot).faults if fault.code == "pulse-overdue"}
    assert world.mode == ("fault" if missing else "ready")
    assert late >= {f"2.{name} (can0/2 output {k})" for k, name in enumerate(("left", "diagonal", "right")) if missing}
    assert missing or not late


def test_the_door_stops_the_arm_within_a_period_and_reset_waits_for_it() -> None:
    world = ready(interlocks=(Interlock("door", "can0", 9, 5, inverted=True),))
    world.run(1, A, B, step=0.3)
    world.go(0.25)
    world.fault("open", "door")
    world.go(TICK)
    assert world.mode == "fault"
    assert world.last(Ended).message == "interlock door (can0/9 input 5) is open: close it, then reset"
    world.send(Reset(1, world.epoch))
    world.go(2.0)
    assert (world.last(Answer).accepted, world.mode, len(world.syncs)) == (False, "fault", 1)
    world.fault("close", "door")
    world.go(2 * STEP)
    world.send(Reset(2, world.epoch))
    world.go(1.0)
    assert (world.last(Answer).accepted, world.mode) == (True, "ready")


SUPPLY = Interlock("supply", "can0", 2, 0, watched=WatchedObject(0x2102, 0))


@pytest.mark.parametrize("variant", ["valve-supply", "mapped-supply"])
@pytest.mark.parametrize("channel", [{}, KINDS["pulses"]], ids=["single", "bistable"])
@pytest.mark.parametrize("lost", ["moving", "at rest", "at the boot"])
def test_a_supply_that_returns_moves_nothing_before_reset_and_a_goal(variant, channel, lost) -> None:
    world = World({"can0/2": VARIANTS[variant]}, interlocks=(SUPPLY,), channel=channel)
    if lost == "at the boot":
        world.fault("open", "supply")
    world.go(2.0)
    if lost != "at the boot":
        world.run(1, A, B, A, B, step=0.4)
        world.go(0.3 if lost == "moving" else 3.0)
        world.fault("open", "supply")
        world.go(1.0)
    assert world.mode == "fault"
    assert "interlock supply (can0/2 2102h sub 0 bit 0) is open" in world.last(Snapshot).reason
    begun, moved = len(world.syncs), world.boards.switches()
    assert lost != "moving" or begun <= (4 if channel else 2), "no further stage begins"
    world.send(Reset(1, world.epoch))
    world.go(1.0)
    assert not world.last(Answer).accepted
    world.fault("close", "supply")
    world.go(3.0)
    assert (world.mode, len(world.syncs), world.boards.switches()) == ("fault", begun, moved)
    world.send(Reset(2, world.epoch))
    world.go(1.0)
    assert (world.mode, len(world.syncs), world.boards.switches()) == ("ready", begun, moved)
    world.run(9, A)
    world.go(2.0)
    assert (world.last(Ended).status, positions(world)) == ("done", A)


def test_a_board_that_comes_back_without_the_object_stays_refused() -> None:
    world = World({"can0/2": VARIANTS["valve-supply"]}, interlocks=(SUPPLY,))
    world.go(2.0)
    world.boards.board("can0/2").objects.refused[SUPPLY.watched] = 0x0602_0000
    world.fault("power_cut", "can0/2")
    world.fault("power_on", "can0/2")
    world.go(1.0)
    world.send(Reset(1, world.epoch))
    world.go(4.0)
    assert world.mode == "fault"
    assert "can0/2 has no 2102h sub 0; an interlock" in world.last(Snapshot).reason


def test_the_arm_contracts_before_the_end_and_heartbeats_continue_until_then() -> None:
    world = World(contract_on_stop=True, on_loss="contract", inrush=2)
    world.go(2.0)
    world.run(1, 0b11, 0b1111)
    world.go(1.0)
    assert positions(world) == 0b1111
    world.post(Quit())
    world.go(0.5)
    assert (world.ended, positions(world)) == (True, 0)
