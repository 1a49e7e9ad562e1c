"""Simulated actuators: positions and end-stops after commands and faults."""

from __future__ import annotations

from typing import Any

import pytest

from hyperbit.drivers.simulation.actuator import CONTRACTED, EXTENDED, Actuator

AT_REST, AT_END, BETWEEN = (1, 0), (0, 1), (0, 0)  # levels of the end-stops: contracted, extended


def made(**options: Any) -> Actuator:
    actuator = Actuator("a", 0.1, **options)
    actuator.step(0.0)
    return actuator


def at(actuator: Actuator, now: float) -> tuple[Any, tuple[int, int]]:
    """Returns position and end-stops at a time."""
    actuator.step(now)
    return pytest.approx(actuator.position), (actuator.reads(CONTRACTED), actuator.reads(EXTENDED))


def test_an_end_stop_reads_1_only_while_the_actuator_is_at_it() -> None:
    it = made()
    it.drive(1, 1.0)
    assert at(it, 1.0) == (0, AT_REST)
    assert it.due == pytest.approx(1.005), "the contracted end's switch opens"
    assert at(it, it.due) == (0.05, BETWEEN)
    assert it.due == pytest.approx(1.1)
    assert at(it, it.due) == (1, AT_END)
    assert it.due == float("inf")
    it.drive(0, 2.0)
    assert at(it, 2.004) == (0.96, AT_END)
    assert at(it, 2.006) == (0.94, BETWEEN)
    assert at(it, 3.0) == (0, AT_REST)
    assert it.switches == 2


def test_each_direction_has_its_travel_time_and_called_back_halfway_it_never_arrives() -> None:
    it = made(contract_time=0.4)
    it.drive(1, 0.0)
    assert at(it, 0.05) == (0.5, BETWEEN)
    it.drive(0, 0.05)
    assert it.due == pytest.approx(0.25)
    assert at(it, 0.15) == (0.25, BETWEEN)
    assert at(it, 1.0) == (0, AT_REST)


def test_a_spring_may_extend() -> None:
    it = made(rest=EXTENDED)
    assert at(it, 0.0) == (1, AT_END)
    it.drive(1, 0.0)
    assert at(it, 0.1) == (0, AT_REST)
    it.drive(0, 1.0)
    assert at(it, 2.0) == (1, AT_END)


def test_stuck_jammed_slow_and_without_feedback() -> None:
    it = made()
    it.stick(1)
    it.step(1.0)
    it.drive(0, 1.0)
    assert at(it, 2.0) == (1, AT_END)
    it.release()
    assert at(it, 3.0) == (0, AT_REST)
    it.jam(0.5)
    for state, time in ((1, 3.0), (0, 4.0)):
        it.drive(state, time)
        assert at(it, time + 1.0) == (0.5, BETWEEN)
    it.release()
    assert at(it, 6.0) == (0, AT_REST)
    it.slow(3)
    it.lose_sensor()
    it.drive(1, 6.0)
    assert at(it, 6.15) == (0.5, AT_REST)
    assert at(it, 7.0) == (1, AT_REST)
    it.restore_sensor()
    assert at(it, 7.0) == (1, AT_END)


def test_a_valve_with_two_coils_stays_as_it_is_without_energy_and_needs_a_pulse() -> None:
    it = made(least_pulse=0.03)
    it.drive(1, 0.0)
    it.drive(0, 0.02)
    assert at(it, 1.0) == (0, AT_REST)
    it.drive(1, 1.0)
    assert it.due == pytest.approx(1.03)
    it.step(it.due)
    it.drive(0, 1.04)
    assert at(it, 1.08) == (0.5, BETWEEN)
    assert at(it, 1.13) == (1, AT_END)
    assert (it.switches, it.longest_pulse) == (1, pytest.approx(0.04))


def test_with_both_coils_on_the_last_winner_stays_and_the_coils_heat() -> None:
    it = made(least_pulse=0.0)
    it.drive(1, 0.0)
    it.drive(1, 1.0, off=1)
    assert (at(it, 2.0), it.both_on) == ((1, AT_END), 1)
    it.drive(0, 2.0, off=1)
    assert (at(it, 3.0), it.both_on) == ((0, AT_REST), 1)
