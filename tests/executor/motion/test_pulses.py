"""The ends of pulses, and actuators that are toggled at every transition."""

from __future__ import annotations

import math

import pytest

from hyperbit.controller.executor.motion.actuation import BUSY_FOR, LATE
from hyperbit.controller.program import TICK, unpack
from hyperbit.drivers.canopen.faults import ArmFault
from tests.executor.rig import ALL, SIZE, TRAVEL, A, Rig, ready

PULSE = 0.05


def test_a_pulse_no_longer_counts_a_tenth_of_a_second_after_its_end() -> None:
    rig = ready(channel={"output_off": True, "pulse": PULSE})
    rig.run(1)
    [(began, _)] = rig.master.left
    over = began + PULSE + LATE
    assert rig.core.motion.actuation.pulsing(math.nextafter(over, 0.0))
    assert not rig.core.motion.actuation.pulsing(over)


def test_a_switch_of_unknown_outcome_is_not_counted_after_a_kill() -> None:
    rig = Rig(channel={"output_off": True, "pulse": PULSE}, sensed=0)
    rig.journal.intend(0b000001, 0)  # of the process before: the states that the next one guesses
    rig.connect()
    rig.go(3 * TICK)
    assert (rig.mode, unpack(rig.snapshot.homing), rig.journal.counts) == ("ready", ALL, [0] * SIZE)


def test_a_bus_is_busy_for_a_quarter_of_a_second_before_this_is_a_fault(rig: Rig) -> None:
    rig.master.busy = True
    actuation = rig.core.motion.actuation
    for now in (0.0, 0.125, BUSY_FOR):
        assert not actuation.switch(A, now)
        assert actuation.fault is None
    assert not actuation.switch(A, 0.375)
    assert actuation.fault == ArmFault("bus-busy", "bus", "no command could be sent for 0.25 s: the queue is full")


def toggle(rig: Rig, times: int) -> int:
    """Switches the first actuator at every transition; returns how often until a fault."""
    for count in range(times):
        if rig.mode == "fault":
            return count
        rig.run(rig.master.outputs.commanded ^ 1, step=1)
        rig.go(TRAVEL + TICK)
    return times


@pytest.mark.parametrize("stuck_at", [0, 1])
def test_an_actuator_toggled_at_every_transition_that_never_arrives_is_found(rig: Rig, stuck_at: int) -> None:
    toggle(rig, stuck_at)
    rig.go(0.2)
    rig.master.stuck = 1
    assert 5 <= toggle(rig, 20) <= 8, "after the third that was missed: every other one is"
    assert "missed 3 commands" in rig.reason


def test_missed_commands_are_forgotten_when_the_end_stop_changes(rig: Rig) -> None:
    for _ in range(3):
        rig.master.stuck = 1
        toggle(rig, 4)  # two are missed: the others are for the state in which it is stuck
        rig.master.stuck = 0
        toggle(rig, 2)
    toggle(rig, 20)
    assert rig.mode != "fault", "an actuator toggled as fast that arrives is not stuck"
