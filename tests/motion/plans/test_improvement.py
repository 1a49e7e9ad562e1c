"""Narrow layers and improvements: fewer switches over a whole trajectory, with every waypoint reached."""

import time

import numpy as np
import pytest

from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.motion.plans import improvement
from hyperbit.controller.motion.plans.improvement import Improvement
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.search.search_time import search_time
from hyperbit.controller.search.solver import Solver
from tests.obstacles.dense import Disc, nearest, obstacles_of

TOLERANCE = 0.002
PERIOD = 1000.0  # [s] between waypoints: no computer is so slow that another one becomes due


@pytest.fixture(scope="module")
def solver(arm, densities):
    return Solver(arm.manipulator, densities)


def curve(count: int, radius: float = 0.3) -> np.ndarray:
    turns = np.linspace(0.0, 2 * np.pi, count)
    return np.column_stack((0.2 + radius * np.cos(turns), 2.6 + radius / 2 * np.sin(turns)))


def cheapest_each_time(solver, start, goals) -> int:
    total, previous = 0, start
    for goal in goals:
        found = solver.solve(solver.target(goal, TOLERANCE), previous, timeout=10.0)
        total, previous = total + found.switches, found.configuration
    return total


def switches(solver, start, configurations) -> int:
    pairs = zip([start, *configurations], configurations, strict=False)
    return sum(solver.manipulator.switches(a, b) for a, b in pairs)


def followed(solver, start, trajectory, width=64) -> np.ndarray:
    search = LabelSetting(solver, list(TrajectoryPoints(solver, trajectory)), start)
    search.narrow(width)
    return search.best.configurations


def through_all(goals):
    return through(PERIOD * np.arange(1, len(goals) + 1), np.array(goals), TOLERANCE)


def test_a_curve_of_100_waypoints_takes_at_least_15_percent_less(solver):
    goals = curve(100)
    start = solver.solve(solver.target(goals[0], TOLERANCE), np.zeros(16, dtype=np.int64), timeout=10.0).configuration
    chosen = followed(solver, start, through_all(goals[1:]))
    tips = solver.manipulator.tips(chosen)[:, :2, 3]
    assert np.linalg.norm(tips - goals[1:], axis=1).max() <= TOLERANCE
    assert switches(solver, start, chosen) <= 0.85 * cheapest_each_time(solver, start, goals[1:])


def hasty_plan(solver, goals):
    """Returns a planner of a trajectory and a plan that has many switches."""
    planner = TransitionPlanner(solver, through_all(goals), Pace(0.06))
    return planner, PointByPoint(planner, "minimum-switch", search_time(0.0)).plan(np.zeros(16, dtype=np.int64))


@pytest.mark.parametrize("due", [1, 10])
def test_improvements_leave_the_first_point_and_those_that_are_due(solver, monkeypatch, due):
    monkeypatch.setattr(improvement, "ROUNDS", ((4, 16),))
    planner, plan = hasty_plan(solver, curve(20))
    better, start = plan, time.monotonic() - PERIOD * due if due > 1 else np.inf
    for better in Improvement(planner, plan, start).plans():
        assert all(a is b for a, b in zip(plan.solutions[:due], better.solutions[:due], strict=True))
        assert all(solution.within_tolerance for solution in better.solutions)
    assert better.cost < plan.cost


def test_sections_of_a_long_trajectory_are_all_improved(solver, monkeypatch):
    monkeypatch.setattr(improvement, "SECTION", 8)
    monkeypatch.setattr(improvement, "ROUNDS", ((4,),))
    planner, plan = hasty_plan(solver, curve(30))
    *_, better = Improvement(planner, plan).plans()
    before, after = (np.array([s.cost for s in each.solutions]) for each in (plan, better))
    assert all(after[k : k + 8].sum() < before[k : k + 8].sum() for k in (1, 8, 16, 22))
    assert all(solution.within_tolerance for solution in better.solutions)


@pytest.mark.parametrize("calls", [1, 3, 30])
def test_an_improvement_ends_when_it_is_told_to(solver, calls):
    planner, plan = hasty_plan(solver, curve(20))
    answers = iter([False] * calls)
    better = plan
    for better in Improvement(planner, plan, stop=lambda: next(answers, True)).plans():
        assert all(solution.within_tolerance for solution in better.solutions)
    assert next(answers, True)

    def cancel() -> bool:
        if next(again, True):
            raise KeyboardInterrupt
        return False

    again = iter([False] * calls)
    with pytest.raises(KeyboardInterrupt):
        list(Improvement(planner, plan, stop=cancel).plans())


def test_a_waypoint_too_far_for_small_tables_is_met_all_the_same(solver):
    start = np.zeros(16, dtype=np.int64)
    goals = [(3.0, 0.7), (-1.5, 2.0), (-1.45, 2.0)]
    chosen = followed(solver, start, through_all(goals))
    tips = solver.manipulator.tips(chosen)[:, :2, 3]
    assert np.linalg.norm(tips - goals, axis=1).max() <= TOLERANCE


def test_every_configuration_ahead_keeps_clear(solver):
    goals, parts = curve(20), [Disc((-0.35, 1.5), 0.15)]
    among = solver.avoiding(BodyClearance(solver.manipulator, obstacles_of(parts), 0.02))
    start = among.solve(among.target(goals[0], TOLERANCE), np.zeros(16, dtype=np.int64)).configuration
    chosen = followed(among, start, through_all(goals[1:]))
    tips = solver.manipulator.tips(chosen)[:, :2, 3]
    assert np.linalg.norm(tips - goals[1:], axis=1).max() <= TOLERANCE
    assert min(nearest(solver.manipulator.body(c), parts) for c in [start, *chosen]) > 0.02
    plain = followed(solver, np.zeros(16, dtype=np.int64), through_all(goals))
    assert min(nearest(solver.manipulator.body(c), parts) for c in plain) < 0.02


def test_weights_decide_what_is_cheap(arm, densities):
    weights = np.where(np.arange(48) < 24, 5.0, 1.0)
    goals = curve(12)
    dear = {}
    for name, solver in (
        ("plain", Solver(arm.manipulator, densities)),
        ("weighted", Solver(arm.manipulator, densities, weights)),
    ):
        start = solver.solve(
            solver.target(goals[0], TOLERANCE), np.zeros(16, dtype=np.int64), "ipop-previous"
        ).configuration
        states = [arm.manipulator.actuator_states(c) for c in (start, *followed(solver, start, through_all(goals[1:])))]
        dear[name] = float((np.diff(np.array(states, dtype=int), axis=0) != 0)[:, :24].sum())
    assert dear["weighted"] < dear["plain"]


def test_orientations_are_kept_along_the_way(solver):
    """At every third waypoint; the configuration stays as long as it serves."""
    m, rng = solver.manipulator, np.random.default_rng(3)
    path = [rng.integers(0, 8, 16)]
    for _ in range(11):
        path.append(np.where(rng.random(16) < 0.15, rng.integers(0, 8, 16), path[-1]))
    tips = m.tips(path)
    turns = np.where(np.arange(12) % 3 == 0, 0.03, np.inf)
    trajectory = through(np.arange(12.0), tips[:, :2, 3], 0.005, None, tips[:, :3, :3], turns)
    for k, configuration in enumerate(followed(solver, path[0], trajectory)):
        tip = m.tip(configuration)
        assert np.linalg.norm(tip[:2, 3] - tips[k, :2, 3]) <= 0.005
        assert angle_between(tip, tips[k]) <= turns[k]
