"""Better plans in time: what a waypoint's actuators switch to is decided before they do."""

import time

import numpy as np
import pytest

from controller.daemon.foresight import Foresight
from controller.motion.lookahead import LookAhead
from controller.motion.pacing import Pace
from controller.motion.plan import plan
from controller.motion.trajectory import through
from controller.search.solver import Solver


@pytest.fixture(scope="module")
def first(arm, densities):
    """A solver, and the first plan of a short curve."""
    solver = Solver(arm.manipulator, densities)
    turns = np.linspace(0.0, 1.5, 12)
    positions = np.column_stack((0.2 + 0.3 * np.cos(turns), 2.6 + 0.2 * np.sin(turns)))
    trajectory = through(np.arange(12.0), positions, 0.002)
    return solver, plan(solver, trajectory, np.zeros(16, dtype=np.int64), "ipop-previous")


def test_the_whole_is_better_and_meets_every_waypoint(first):
    solver, rough = first
    better = Foresight(solver, rough, Pace(0.06)).whole()
    assert better.switches < rough.switches
    assert all(solution.within_tolerance for solution in better.solutions)
    np.testing.assert_array_equal(better.solutions[0].configuration, rough.solutions[0].configuration)
    states = [solver.manipulator.actuator_states(s.configuration) for s in better.solutions]
    np.testing.assert_array_equal(better.actuator_states, states)
    following = [
        solver.manipulator.switches(a.configuration, b.configuration)
        for a, b in zip(better.solutions, better.solutions[1:], strict=False)
    ]
    assert [s.switches for s in better.solutions[1:]] == following


def test_a_hurried_plan_leaves_it_to_looking_ahead_to_reckon_how_far_the_tip_strays(first, monkeypatch):
    solver, rough = first
    monkeypatch.setattr("controller.motion.plan.PLANNING_TIME", 0.0)
    start, pace = np.zeros(16, dtype=np.int64), Pace(0.06)
    hurried = plan(solver, rough.trajectory, start, "minimum-switch", pace=pace)
    assert {transition.excursion for transition in hurried.transitions} == {None}
    better = Foresight(solver, hurried, pace).whole()
    assert all(transition.excursion is not None for transition in better.transitions[1:])


def test_no_waypoint_changes_once_it_is_due(first, monkeypatch):
    """The clock runs a waypoint ahead with every one that is planned: each has to be decided at once."""
    solver, rough = first
    now = [time.monotonic()]
    monkeypatch.setattr("controller.daemon.foresight.time.monotonic", lambda: now[0])
    foresight, fixed = Foresight(solver, rough, Pace(0.06)), {}
    for k, better in enumerate(foresight.betters(), 1):
        for waypoint, configuration in fixed.items():
            np.testing.assert_array_equal(better.solutions[waypoint].configuration, configuration)
        fixed = {waypoint: better.solutions[waypoint].configuration for waypoint in range(k)}
        now[0] += 1.0
    assert len(fixed) == 11


def test_the_time_that_the_next_waypoint_takes_is_reserved(first, monkeypatch):
    """Leading on takes most of the time between two waypoints: none may change after its actuators were to switch."""
    solver, rough = first
    now = [100.0]

    class Slow(LookAhead):
        def extend(self):
            super().extend()
            now[0] += 0.7

    for clock in ("monotonic", "perf_counter"):
        monkeypatch.setattr(f"controller.daemon.foresight.time.{clock}", lambda: now[0])
    monkeypatch.setattr("controller.daemon.foresight.LookAhead", Slow)
    last = rough
    for better in Foresight(solver, rough, Pace(0.06)).betters():
        begun = rough.trajectory.times + 100.0 < now[0]
        for before, after in zip(np.array(last.solutions)[begun], np.array(better.solutions)[begun], strict=True):
            np.testing.assert_array_equal(before.configuration, after.configuration)
        last = better
    assert last.switches < rough.switches


def test_a_plan_of_one_waypoint_stays(arm, first):
    solver, rough = first
    single = through(np.zeros(1), rough.trajectory.positions[:1], 0.002)
    alone = plan(solver, single, np.zeros(16, dtype=np.int64), "minimum-switch")
    assert Foresight(solver, alone, Pace(0.06)).whole() is alone
