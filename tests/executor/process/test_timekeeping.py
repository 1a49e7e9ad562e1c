"""The clock of the event loop."""

import pytest

from hyperbit.controller.executor.process.run import Timekeeper


@pytest.fixture
def keeper() -> Timekeeper:
    keeper = Timekeeper(0.01)
    keeper.start(50.0)
    return keeper


def test_ticks_are_due_by_the_period(keeper: Timekeeper) -> None:
    assert keeper.remaining(50.0) == 0
    keeper.ticked(50.0, 50.002)
    assert keeper.remaining(50.002) == pytest.approx(0.008)
    assert keeper.remaining(51.0) == 0


def test_a_late_tick_does_not_shift_the_next(keeper: Timekeeper) -> None:
    keeper.ticked(50.004, 50.005)
    assert keeper.remaining(50.005) == pytest.approx(0.005)


def test_missed_ticks_are_counted_and_skipped(keeper: Timekeeper) -> None:
    keeper.ticked(50.0, 50.034)
    assert keeper.remaining(50.034) == pytest.approx(0.006)
    assert keeper.drain_figures()["overruns"] == 3


def test_figures_are_of_the_time_since_they_were_last_taken(keeper: Timekeeper) -> None:
    keeper.ticked(50.0, 50.001)
    keeper.ticked(50.015, 50.018)
    status = keeper.drain_figures()
    assert status["ticks"] == 2
    assert status["longest_period"] == pytest.approx(0.015)
    assert status["mean_work"] == pytest.approx(0.002)
    assert status["longest_work"] == pytest.approx(0.003)
    assert status["late_p99"] == status["late_worst"] == pytest.approx(0.005)
    assert not any(keeper.drain_figures().values())
