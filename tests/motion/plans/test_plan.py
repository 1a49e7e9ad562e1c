"""Plans of trajectories."""

import re
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.manipulator.frames import planar
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.plans.plan import TrajectoryPlan
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.trajectory import Trajectory, through
from hyperbit.controller.refusals.codes import GOAL_TOLERANCE_VIOLATED
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.method import Method
from hyperbit.controller.search.search_time import SearchTime
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.search.target import SearchTarget

POINTS = [(0.55, 2.9), (0.4, 2.9), (3.0, 0.7)]


def trajectory(*positions: tuple[float, float], tolerance: float = 0.002) -> Trajectory:
    return through(np.arange(len(positions), dtype=float), np.array(positions), tolerance)


def contracted(manipulator: Manipulator) -> np.ndarray:
    return np.zeros(len(manipulator.modules), dtype=np.int64)


def planned(
    solver: Solver, goal: Trajectory, method: Method, proceed: Callable[[], None] = lambda: None
) -> TrajectoryPlan:
    return PointByPoint(TransitionPlanner(solver, goal), method).plan(contracted(solver.manipulator), proceed)


def test_each_waypoint_is_searched_from_the_one_before(solver: Solver, manipulator: Manipulator) -> None:
    found = planned(solver, trajectory(*POINTS), "ipop-previous")
    previous = contracted(manipulator)
    for k, point in enumerate(POINTS):
        expected = solver.solve(solver.target(point, 0.002), previous, "ipop-previous")
        assert found.solutions[k].configuration.tolist() == expected.configuration.tolist()
        assert found.solutions[k].switches == manipulator.switches(previous, expected.configuration)
        previous = expected.configuration


def test_switches_are_those_of_all_waypoints(solver: Solver, manipulator: Manipulator) -> None:
    found = planned(solver, trajectory(*POINTS), "ipop-previous")
    states = np.vstack([manipulator.actuator_states(contracted(manipulator)), found.actuator_states])
    assert found.switches == np.count_nonzero(np.diff(states.astype(int), axis=0)) > 0


def test_a_corrected_goal_out_of_reach_is_told_as_it_was_asked(solver: Solver, manipulator: Manipulator) -> None:
    bias = np.array([0.25, -0.5])
    with pytest.raises(Refusal) as caught:
        planned(solver, trajectory((9, 9.5)).corrected(bias), "ipop-previous")
    form = r".*: \(9, 9\.5\) seems out of reach; .* \((\S+), (\S+)\), (\S+) away,.* \(0\.2500, -0\.5000\)"
    match = re.fullmatch(form, str(caught.value))
    assert match
    x, y, away = map(float, match.groups())
    assert away == pytest.approx(np.hypot(9 - 0.25 - x, 9.5 + 0.5 - y), abs=2e-4)


def test_staying_switches_nothing(solver: Solver, manipulator: Manipulator) -> None:
    found = planned(solver, trajectory(POINTS[0], POINTS[0]), "ipop-previous")
    assert found.solutions[1].switches == 0


def test_out_of_reach_names_waypoint_nearest_point_and_distance(solver: Solver, manipulator: Manipulator) -> None:
    with pytest.raises(Refusal) as caught:
        planned(solver, trajectory(POINTS[0], (9, 9.5)), "ipop-previous")
    assert caught.value.code == GOAL_TOLERANCE_VIOLATED
    form = (
        r"waypoint 2, position: \(9, 9\.5\) seems out of reach; the nearest point found is \((\S+), (\S+)\),"
        r" (\S+) away, tolerance 0\.002"
    )
    match = re.fullmatch(form, str(caught.value))
    assert match
    x, y, away = map(float, match.groups())
    assert away == pytest.approx(np.hypot(9 - x, 9.5 - y), abs=2e-4)


def test_planning_can_be_ended_between_waypoints(solver: Solver, manipulator: Manipulator) -> None:
    asked = []

    def proceed() -> None:
        asked.append(1)
        if len(asked) == 2:
            raise Refusal(Reason.OVERTAKEN)

    with pytest.raises(Refusal, match="a cancel, stop, reset or fault"):
        planned(solver, trajectory(*POINTS), "ipop-previous", proceed)
    assert len(asked) == 2


def posed(tips: np.ndarray, turns: list[float]) -> Trajectory:
    times = np.arange(len(tips), dtype=float)
    return through(times, tips[:, :2, 3], 0.005, None, tips[:, :3, :3], np.array(turns))


@pytest.mark.parametrize("method", ["minimum-switch", "ipop-previous"])
def test_waypoints_are_reached_in_their_orientation(solver: Solver, manipulator: Manipulator, method) -> None:
    tips = manipulator.tips(np.random.default_rng(5).integers(0, 8, (4, 16)))
    found = planned(solver, posed(tips, [0.03, np.inf, 0.03, 0.03]), method)
    for k, solution in enumerate(found.solutions):
        assert np.linalg.norm(solution.tip[:2, 3] - tips[k, :2, 3]) <= 0.005
        assert k == 1 or angle_between(solution.tip, tips[k]) <= 0.03


def test_an_orientation_out_of_reach_is_told_with_the_nearest_pose(solver: Solver, manipulator: Manipulator) -> None:
    backwards = manipulator.tips(contracted(manipulator)[None]) @ planar(0.0, 0.0, np.pi)
    with pytest.raises(Refusal) as caught:
        planned(solver, posed(backwards, [0.03]), "minimum-switch")
    assert caught.value.code == GOAL_TOLERANCE_VIOLATED
    form = r".* out of reach in this orientation; the nearest pose found is at .* and turned (\S+) rad, .* and 0\.03"
    match = re.fullmatch(form, str(caught.value))
    assert match
    assert float(match[1]) > 0.03


class Ended(Exception):
    """Nobody wants the plan any more."""


def test_planning_ends_in_the_middle_of_a_search(solver: Solver) -> None:
    """No configuration is within this tolerance: the search would take its hour."""
    calls = 0

    def proceed() -> bool:
        nonlocal calls
        calls += 1
        if calls > 5:
            raise Ended
        return False

    planner = TransitionPlanner(solver, trajectory(POINTS[0], tolerance=1e-9))
    with pytest.raises(Ended):
        PointByPoint(planner, "minimum-switch", SearchTime(0.0, unfound=3600.0)).plan(
            contracted(solver.manipulator), proceed
        )


def test_the_gap_extends_the_search_of_the_first_point_only(solver: Solver, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, solve = list[SearchTime](), Solver.solve

    def recorded(self: Solver, target: SearchTarget, previous: np.ndarray, method: Method, *more: Any) -> Solution:
        asked.append(more[0])
        return solve(self, target, previous, method, *more)

    monkeypatch.setattr(Solver, "solve", recorded)
    planner = TransitionPlanner(solver, trajectory(*POINTS))
    PointByPoint(planner, "minimum-switch", SearchTime(60.0, 0.5, 70.0, 80.0)).plan(contracted(solver.manipulator))
    assert [time.per_switch for time in asked] == [0.5, 0.0, 0.0]
    assert [time.unfound for time in asked] == [70.0] * 3
    assert all(80.0 >= a.most > b.most for a, b in pairwise(asked))
