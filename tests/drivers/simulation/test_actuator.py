from __future__ import annotations

import pytest

from hyperbit.drivers.simulation.actuator import CONTRACTED, EXTENDED, Actuator


@pytest.fixture
def actuator() -> Actuator:
    actuator = Actuator("a", 0.1)
    actuator.step(0.0)
    return actuator


def ends(actuator: Actuator) -> tuple[int, int]:
    return actuator.reads(CONTRACTED), actuator.reads(EXTENDED)


def at(actuator: Actuator, now: float) -> tuple[float, tuple[int, int]]:
    actuator.step(now)
    return pytest.approx(actuator.position), ends(actuator)


def test_an_end_stop_reads_1_only_while_the_actuator_is_at_it(actuator):
    assert ends(actuator) == (1, 0)
    actuator.drive(1, 1.0)
    assert at(actuator, 1.0) == (0, (1, 0))
    assert actuator.due == pytest.approx(1.005), "the contracted end's switch opens"
    assert at(actuator, actuator.due) == (0.05, (0, 0))
    assert actuator.due == pytest.approx(1.1)
    assert at(actuator, 1.05) == (0.5, (0, 0))
    assert at(actuator, actuator.due) == (1, (0, 1))
    assert actuator.due == float("inf")
    actuator.drive(0, 2.0)
    assert at(actuator, 2.004) == (0.96, (0, 1))
    assert at(actuator, 2.006) == (0.94, (0, 0))
    assert at(actuator, 3.0) == (0, (1, 0))
    assert actuator.switches == 2


def test_called_back_halfway_it_never_arrives(actuator):
    actuator.drive(1, 1.0)
    actuator.drive(0, 1.05)
    assert actuator.due == pytest.approx(1.1)
    assert at(actuator, 1.06) == (0.4, (0, 0))
    assert at(actuator, 2.0) == (0, (1, 0))


def test_each_direction_has_its_travel_time():
    actuator = Actuator("a", 0.1, 0.4)
    actuator.drive(1, 0.0)
    assert at(actuator, 0.05) == (0.5, (0, 0))
    actuator.drive(0, 0.05)
    assert actuator.due == pytest.approx(0.25)
    assert at(actuator, 0.15) == (0.25, (0, 0))


def test_stuck_it_goes_to_its_end_and_stays(actuator):
    actuator.stick(1)
    actuator.step(1.0)
    actuator.drive(0, 1.0)
    assert at(actuator, 2.0) == (1, (0, 1))
    actuator.release()
    assert at(actuator, 3.0) == (0, (1, 0))


def test_jammed_half_way_it_moves_in_neither_direction(actuator):
    actuator.jam(0.5)
    actuator.drive(1, 1.0)
    assert at(actuator, 2.0) == (0.5, (0, 0))
    actuator.drive(0, 2.0)
    assert at(actuator, 3.0) == (0.5, (0, 0))
    actuator.release()
    assert at(actuator, 4.0) == (0, (1, 0))


def test_slow_and_without_feedback(actuator):
    actuator.slow(3)
    actuator.lose_sensor()
    actuator.drive(1, 1.0)
    assert at(actuator, 1.15) == (0.5, (1, 0))
    assert at(actuator, 2.0) == (1, (1, 0))
    actuator.restore_sensor()
    assert ends(actuator) == (0, 1)


def test_a_spring_may_extend():
    actuator = Actuator("a", 0.1, rest=EXTENDED)
    assert (actuator.position, ends(actuator)) == (1, (0, 1))
    actuator.drive(1, 0.0)
    assert at(actuator, 0.1) == (0, (1, 0))
    actuator.drive(0, 1.0)
    assert at(actuator, 2.0) == (1, (0, 1))


def test_a_valve_with_two_coils_stays_as_it_is_without_energy():
    actuator = Actuator("a", 0.1, least_pulse=0.0)
    actuator.drive(1, 0.0)
    actuator.drive(0, 0.01)
    assert at(actuator, 0.1) == (1, (0, 1))
    actuator.drive(0, 1.0, off=1)
    actuator.drive(0, 1.02)
    assert at(actuator, 1.1) == (0, (1, 0))
    assert actuator.switches == 2
    assert actuator.longest_pulse == pytest.approx(0.02)


def test_a_pulse_that_is_too_short_does_not_switch_the_valve():
    actuator = Actuator("a", 0.1, least_pulse=0.03)
    actuator.drive(1, 0.0)
    actuator.drive(0, 0.02)
    assert at(actuator, 1.0) == (0, (1, 0))
    actuator.drive(1, 1.0)
    assert actuator.due == pytest.approx(1.03)
    actuator.step(actuator.due)
    actuator.drive(0, 1.04)
    assert at(actuator, 1.08) == (0.5, (0, 0))
    assert at(actuator, 1.13) == (1, (0, 1))
    assert actuator.switches == 1


def test_with_both_coils_on_the_last_winner_stays_and_the_coils_heat():
    actuator = Actuator("a", 0.1, least_pulse=0.0)
    actuator.drive(1, 0.0)
    actuator.drive(1, 1.0, off=1)
    assert at(actuator, 2.0) == (1, (0, 1))
    assert actuator.both_on == 1
    actuator.drive(0, 2.0, off=1)
    assert at(actuator, 3.0) == (0, (1, 0))
    assert actuator.both_on == 1
