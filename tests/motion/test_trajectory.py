"""Trajectories, and measured poses beside their targets."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.notation import format_configuration
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import MOST_STAGES, Pace
from hyperbit.controller.motion.targets import UNKNOWN, GoalTarget, measured_pose, measured_tip
from hyperbit.controller.motion.trajectory import MOST_POINTS, Trajectory, along, through, upwards
from hyperbit.controller.refusals.codes import GOAL_TOLERANCE_VIOLATED, INVALID_GOAL
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.search_time import search_time

PACE = Pace(0.06)
STAGED = Pace(0.06, inrush=2, rest=0.1)
WAYPOINTS = np.array([(0.2, 2.9), (0.5, 2.7), (0.3, 2.6)])


def wanted(times: np.ndarray, positions: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """The target at times (k,), shape (k, dimension)."""
    return np.column_stack([np.interp(moments, times, column) for column in positions.T])


def farthest(times: np.ndarray, positions: np.ndarray, trajectory: Trajectory, tips: np.ndarray) -> float:
    """The greatest distance of the target from tips (n, dimension); each tip stays from its point to the next."""
    worst = 0.0
    for k, tip in enumerate(tips[:-1]):
        moments = np.linspace(trajectory.times[k], trajectory.times[k + 1], 40)
        worst = max(worst, float(np.linalg.norm(wanted(times, positions, moments) - tip, axis=1).max()))
    return worst


coordinates = st.floats(-2, 2)
lines = st.integers(2, 3).flatmap(
    lambda d: st.lists(st.lists(coordinates, min_size=d, max_size=d), min_size=2, max_size=4)
)


@given(lines, st.floats(0.02, 1), st.floats(0.001, 1), st.floats(0.2, 100), st.sampled_from([PACE, STAGED]), st.data())
def test_any_tip_that_serves_stays_within_until_the_next_point(positions, path, tolerance, step, pace, data):
    positions, times = np.array(positions), 1.0 + step * np.arange(len(positions))
    try:
        found = along(times, positions, tolerance, path, pace, 7.0)
    except Refusal:
        assume(False)
    assert (found.stamp, found.path_tolerance) == (7.0, path)
    assert len(found.times) == len(found.positions) == len(found.tolerances) <= MOST_POINTS
    assert (np.diff(found.times) >= pace.shortest - 1e-9).all()
    np.testing.assert_allclose(found.times[found.waypoints], times)
    np.testing.assert_allclose(found.positions[found.waypoints], positions)
    assert (found.tolerances[found.waypoints] <= tolerance).all()
    assert (found.tolerances >= min(tolerance, path / 2) * (1 - 1e-8)).all()
    away = data.draw(st.lists(coordinates, min_size=positions.shape[1], max_size=positions.shape[1]))
    assume(np.linalg.norm(away) > 1e-3)
    tips = found.positions + np.outer(found.tolerances, np.array(away) / np.linalg.norm(away))
    assert farthest(times, positions, found, tips) <= path * (1 + 1e-8)


def test_points_are_numbered_by_the_waypoints_around_them():
    found = along(np.array([0.0, 1.0, 3.0]), np.array([(0.0, 0.0), (0.2, 0.0), (0.2, 0.2)]), 0.002, 0.1, PACE)
    assert found.waypoints.tolist() == [0, 8, 16]
    assert [found.between(k) for k in (0, 1, 7, 8, 9, 16)] == [False, True, True, False, True, False]
    assert [found.last(k) for k in (-1, 0, 7, 8, 15, 16)] == [-1, 0, 0, 1, 1, 2]
    assert [found.next(k) for k in (0, 1, 8, 9)] == [0, 1, 1, 2]
    assert found.times[:3].tolist() == [0.0, 0.125, 0.25]
    np.testing.assert_allclose(found.positions[[1, 7]], [(0.0375, 0.0), (0.1875, 0.0)])
    assert found.tolerances[[0, 1]].tolist() == pytest.approx([0.002, 0.0875])


def test_without_length_and_without_lines_there_are_no_points_between():
    still = along(np.array([0.0, 1.0]), np.zeros((2, 2)), 0.002, 0.001, PACE)
    single = along(np.zeros(1), np.zeros((1, 2)), 0.002, 0.01, PACE)
    assert (len(still.times), still.tolerances.tolist()) == (2, [0.001, 0.001])
    assert (len(single.times), single.tolerances.tolist()) == (1, [0.002])
    assert not through(np.arange(3.0), WAYPOINTS, 0.002).between(1)


def test_an_arm_that_takes_stages_gets_as_much_time_for_each_point_as_it_can_use():
    times, positions = np.array([0.0, 12.0]), np.array([(0.0, 0.0), (1.0, 0.0)])
    assert len(along(times, positions, 0.002, 0.1, PACE).times) == 41
    each = 12.0 / (len(along(times, positions, 0.002, 0.1, STAGED).times) - 1)
    assert each >= STAGED.unhurried == pytest.approx(0.06 * MOST_STAGES + 0.1)


@given(st.floats(0.01, 5), st.floats(0.005, 0.5), st.sampled_from([PACE, STAGED]))
def test_a_line_too_fast_is_refused_naming_the_pair_and_a_time_that_does(length, path, pace):
    positions = np.array([(0.0, 0.0), (0.0, 0.0), (length, 0.0)])
    fast = np.array([0.0, 1.0, 1.0 + pace.shortest])
    assume(2 * length > path)
    with pytest.raises(Refusal, match=rf"^waypoint 2 to 3: .* path_tolerance {path:g}, the") as caught:
        along(fast, positions, 0.002, path, pace)
    assert caught.value.code == INVALID_GOAL
    seconds = float(re.search(r"need (\S+) s$", str(caught.value))[1])
    assert along(np.array([0.0, 1.0, 1.0 + seconds]), positions, 0.002, path, pace).path_tolerance == path


@pytest.mark.parametrize("path", [1e-9, 1e-5, 1.9e-4])
def test_too_many_points_are_refused_naming_a_tolerance_that_does(path):
    times, positions = np.array([0.0, 9e4]), np.array([(0.0, 0.0), (1.0, 0.0)])
    with pytest.raises(Refusal, match=rf"^path_tolerance: {path:g} takes .* at most {MOST_POINTS} are acc") as caught:
        along(times, positions, 0.002, path, PACE)
    enough = float(re.search(r"; (\S+) would do", str(caught.value))[1])
    assert MOST_POINTS * 0.9 < len(along(times, positions, 0.002, enough, PACE).times) <= MOST_POINTS


@given(st.floats(1e-9, 1e9))
def test_rounded_upwards_to_three_digits(value):
    assert value * (1 - 1e-8) <= float(f"{upwards(value):g}") <= value * 1.0101


@pytest.mark.parametrize("method", ["minimum-switch", "ipop-previous", "pop"])
def test_a_plan_holds_what_serves_and_is_never_off_the_line(solver, method):
    times = np.array([0.0, 5.0, 8.0])
    trajectory = along(times, WAYPOINTS, 0.002, 0.03, PACE)
    found = PointByPoint(TransitionPlanner(solver, trajectory, PACE), method).plan(np.zeros(16, dtype=np.int64))
    tips = np.array([solution.tip[:2, 3] for solution in found.solutions])
    assert farthest(times, WAYPOINTS, trajectory, tips) <= 0.03
    moved = [k for k, solution in enumerate(found.solutions) if solution.switches]
    for k in moved:
        if trajectory.between(k):
            assert np.linalg.norm(tips[k - 1] - trajectory.positions[k]) > trajectory.tolerances[k], "it served"
    assert len(moved) < len(found.solutions) / 2
    states = np.vstack([np.zeros(48, dtype=int), found.actuator_states.astype(int)])
    assert np.abs(np.diff(states, axis=0)).sum(axis=1).tolist() == [s.switches for s in found.solutions]


def test_looking_ahead_switches_a_quarter_less_than_the_cheapest_each_time(solver):
    times = np.array([0.0, 20.0, 30.0])
    trajectory = along(times, WAYPOINTS, 0.002, 0.02, PACE)
    rest, tolerances = trajectory.positions[1:], trajectory.tolerances[1:]
    start = solver.solve(solver.target(WAYPOINTS[0], 0.002), np.zeros(16, dtype=np.int64), timeout=10.0).configuration
    own, cheapest = start, 0
    for goal, tolerance in zip(rest, tolerances, strict=True):
        found = solver.solve(solver.target(goal, float(tolerance)), own, timeout=10.0)
        own, cheapest = found.configuration, cheapest + found.switches
    search = LabelSetting(solver, list(TrajectoryPoints(solver, trajectory))[1:], start)
    search.narrow(64)
    chosen = [start, *search.best.configurations]
    tips = solver.manipulator.tips(chosen)[:, :2, 3]
    assert farthest(times, WAYPOINTS, trajectory, tips) <= 0.02
    switches = sum(solver.manipulator.switches(a, b) for a, b in pairwise(chosen))
    assert switches <= 0.75 * cheapest


def test_for_too_few_stages_the_search_is_given_more_time_and_then_the_line_is_named(solver):
    home, times = np.zeros(16, dtype=np.int64), np.array([0.0, 15.0])
    line = np.array([(-0.2, 2.5), (0.2, 2.25)])
    staged, single = Pace(0.06, inrush=2), Pace(0.06, inrush=1)
    planner = TransitionPlanner(solver, along(times, line, 0.002, 0.02, staged), staged)
    first = search_time(0.0)  # without time the first answers have many switches
    found = PointByPoint(planner, "minimum-switch", first).plan(home)
    for transition, solution in list(zip(found.transitions, found.solutions, strict=True))[1:]:
        assert len(transition.stages) >= solution.switches / 2
    fast = TransitionPlanner(solver, along(np.array([0.0, 4.0]), line, 0.002, 0.02, single), single)
    with pytest.raises(Refusal, match=r"^waypoint 1 to 2, one of \d+ parts: .* and the line \S+ s$"):
        PointByPoint(fast, "pop").plan(home)


def test_a_point_of_a_line_out_of_reach_names_the_line_and_the_nearest_found(solver):
    ends = solver.manipulator.tips([[2] * 16, [4] * 16])[:, :2, 3]  # bent to either side
    trajectory = along(np.array([0.0, 60.0]), ends, 0.002, 0.05, PACE)
    with pytest.raises(Refusal) as caught:
        PointByPoint(TransitionPlanner(solver, trajectory), "pop").plan(np.zeros(16, dtype=np.int64))
    assert caught.value.code == GOAL_TOLERANCE_VIOLATED
    form = (
        r"waypoint 1 to 2: \(\S+, \S+\) seems out of reach; the nearest point found is \(.*\),"
        r" \S+ away, tolerance \S+"
    )
    assert re.fullmatch(form, str(caught.value)), str(caught.value)


@pytest.mark.parametrize("seed", range(5))
def test_the_angle_to_a_target(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tip, target = (frames.spatial(rng.normal(size=3), rng.normal(size=4)) for _ in range(2))
    assert GoalTarget(target[:3, 3], 0.1, target[:3, :3]).angle(tip) == pytest.approx(frames.angle_between(tip, target))
    assert GoalTarget(target[:3, 3], 0.1).angle(tip) is None


def test_the_measured_pose_and_its_errors(manipulator: Manipulator) -> None:
    configuration, dimension = np.arange(len(manipulator.modules)) % 4, manipulator.dimension
    measured, tip = manipulator.actuator_states(configuration).astype(np.int8), manipulator.tip(configuration)
    away = np.array([0.03, 0.04, 0.0][:dimension])
    where = measured_pose(manipulator, measured, GoalTarget(tip[:dimension, 3] + away, 0.1))
    assert where["configuration"] == format_configuration(manipulator, configuration)
    assert where["position"] == pytest.approx(tip[:dimension, 3])
    assert (where["error"], where["orientation_error"]) == (pytest.approx(0.05), None)
    assert measured_pose(manipulator, measured, None)["error"] is None


def test_unknown_states_have_no_pose(manipulator: Manipulator) -> None:
    measured = np.full(len(manipulator.actuators), -1, np.int8)
    assert measured_tip(manipulator, measured) is None
    assert measured_pose(manipulator, measured, None) == UNKNOWN
