from __future__ import annotations

import pytest

from drivers.simulation.actuator import Actuator


@pytest.fixture
def actuator() -> Actuator:
    actuator = Actuator("a", 0.1)
    actuator.step(0.0)
    return actuator


def test_travels_and_its_end_stop_changes_on_arrival_only(actuator):
    actuator.drive(1, 1.0)
    assert actuator.arrival == pytest.approx(1.1)
    actuator.step(1.05)
    assert (actuator.position, actuator.sensor) == (pytest.approx(0.5), 0)
    actuator.step(actuator.arrival)
    assert (actuator.position, actuator.sensor, actuator.arrival) == (1, 1, None)
    actuator.drive(0, 2.0)
    actuator.step(2.05)
    assert actuator.sensor == 1
    actuator.step(3.0)
    assert (actuator.position, actuator.sensor, actuator.switches) == (0, 0, 2)


def test_called_back_halfway_it_never_arrives(actuator):
    actuator.drive(1, 1.0)
    actuator.drive(0, 1.05)
    assert actuator.arrival == pytest.approx(1.1)
    actuator.step(2.0)
    assert (actuator.position, actuator.sensor) == (0, 0)


def test_stuck_it_goes_to_its_end_and_stays(actuator):
    actuator.stick(1)
    actuator.step(1.0)
    actuator.drive(0, 1.0)
    actuator.step(2.0)
    assert actuator.position == 1
    actuator.release()
    actuator.step(3.0)
    assert actuator.position == 0


def test_slow_and_without_sensor(actuator):
    actuator.slow(3)
    actuator.lose_sensor()
    actuator.drive(1, 1.0)
    assert actuator.arrival == pytest.approx(1.3)
    actuator.step(2.0)
    assert (actuator.position, actuator.sensor) == (1, 0)
    actuator.restore_sensor()
    assert actuator.sensor == 1


def test_without_travel_time_it_is_there_at_once():
    actuator = Actuator("a", 0.0)
    actuator.drive(1, 0.0)
    actuator.step(0.0)
    assert actuator.position == 1
