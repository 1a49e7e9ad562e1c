"""Goals, paths and pictures of the library."""

import math
from typing import Any

import numpy as np
import pytest

import hyperbit as hb
from tests.arms import every_configuration, paper_arm

EVERY = every_configuration(paper_arm(4))
DEADLINE = 30.0  # [s], so that a busy machine proves as much as an idle one


@pytest.fixture(scope="module")
def ik(arm: hb.Arm) -> hb.Solver:
    return hb.Solver(arm)


def fewest(
    arm: hb.Arm, goal: np.ndarray, tolerance: float, start: np.ndarray, served: np.ndarray | None = None
) -> float:
    near = np.linalg.norm(arm.frames(EVERY)[:, :2, 3] - goal, axis=1) <= tolerance
    chosen = EVERY[near if served is None else near & served]
    return min((arm.switches(start, row) for row in chosen), default=math.inf)


def test_solutions_are_optimal_where_they_say_so(arm: hb.Arm, ik: hb.Solver) -> None:
    for configuration in arm.sample(10, seed=1):
        goal = arm.position(configuration)
        solution = ik.solve(goal, start=arm.home, deadline=DEADLINE)
        assert solution.certificate == "optimal"
        assert solution.switches == fewest(arm, goal, arm.tolerance, arm.home)
        assert np.linalg.norm(arm.position(solution.configuration) - goal) == pytest.approx(solution.error)


def test_goals_have_their_own_tolerances(arm: hb.Arm, ik: hb.Solver) -> None:
    frame = arm.frame([3, 1, 4, 1])
    angle = math.atan2(frame[1, 0], frame[0, 0])
    solution = ik.solve(hb.Goal(frame[:2, 3], angle, tolerance=1e-6, angle_tolerance=1e-6), deadline=DEADLINE)
    assert solution.within_tolerance
    np.testing.assert_allclose(arm.frame(solution.configuration), frame, atol=1e-5)


def test_goals_out_of_reach_are_proven_so(ik: hb.Solver) -> None:
    solution = ik.solve((100.0, 100.0), deadline=DEADLINE)
    assert not solution.within_tolerance
    assert solution.certificate == "unreachable"


def test_locked_actuators_stay_in_solutions(arm: hb.Arm) -> None:
    locked = arm.lock({"2.left": "extended"})
    goal = locked.position(locked.sample(1, seed=5)[0])
    solution = hb.Solver(locked).solve(goal, deadline=DEADLINE)
    assert solution.within_tolerance
    place = arm.actuators.index("2.left")
    assert locked.actuator_states(solution.configuration)[place] == 1
    served = np.array([arm.actuator_states(row)[place] == 1 for row in EVERY])
    assert solution.switches == fewest(arm, goal, arm.tolerance, locked.home, served)


def test_configurations_avoid_obstacles(arm: hb.Arm) -> None:
    ik = hb.Solver(arm, obstacles=[hb.Disc((0.3, 0.6), 0.15, "pillar")])
    clear = np.array([ik.contact(row) is None for row in EVERY])
    assert 0 < clear.sum() < len(EVERY)
    dearer = 0
    for goal in arm.frames(EVERY[clear][::150])[:, :2, 3]:
        solution = ik.solve(goal, deadline=DEADLINE)
        assert solution.clear
        assert ik.contact(solution.configuration) is None
        assert solution.certificate == "optimal"
        assert solution.switches == fewest(arm, goal, arm.tolerance, arm.home, clear)
        dearer += solution.switches > fewest(arm, goal, arm.tolerance, arm.home)
    assert dearer > 0, "no goal needs more switches because of the obstacle: move it"
    ik = hb.Solver(arm, obstacles=[hb.Disc(arm.position(arm.home), 0.05, "pillar")])
    assert ik.contact(arm.home) == "module 4 is in disc 'pillar'"


def test_a_goal_in_an_obstacle_is_out_of_reach_only_with_a_proof() -> None:
    arm = hb.Arm([hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=16)], tolerance=0.002)
    goal, reasons = arm.position(arm.home), list[str]()
    for depth in (0.05, 1e-4):  # from the edge; the tolerance is between
        ik = hb.Solver(arm, obstacles=[hb.Disc(goal + np.array((0.05 - depth, 0)), 0.05, "pillar")])
        reasons.append(ik.solve(goal, effort=1).reach)
    assert reasons == ["is in disc 'pillar'", "is in disc 'pillar', and no clear tip within the tolerance was found"]


def test_weights_change_the_cheapest_configuration(arm: hb.Arm) -> None:
    weights = np.where([label.startswith("1.") for label in arm.actuators], 50.0, 1.0)
    solution = hb.Solver(arm, weights=weights).solve(arm.position([0, 3, 3, 3]), deadline=DEADLINE)
    assert solution.cost < 50
    assert solution.configuration[0] == 0


def test_paths_begin_where_the_last_ended(arm: hb.Arm, ik: hb.Solver) -> None:
    goals = [arm.position(row) for row in arm.sample(4, seed=2)]
    first = ik.solve(goals[0])
    path = ik.follow(goals[1:], start=first)
    assert path.waypoints.tolist() == [0, 1, 2]
    before = first.configuration
    for goal, row, solution in zip(goals[1:], path.configurations, path.solutions, strict=True):
        assert np.linalg.norm(arm.position(row) - goal) <= arm.tolerance
        assert solution.switches == arm.switches(before, row)
        before = row
    assert path.switches == sum(solution.switches for solution in path.solutions)
    assert path.cost >= path.bound
    again = ik.follow([goals[0]], start=path)
    assert again.solutions[0].switches == arm.switches(before, again.configurations[0])


@pytest.mark.parametrize("means", [{}, {"prove": True}])
def test_paths_of_fewest_switches_are_proven(arm: hb.Arm, ik: hb.Solver, means: dict[str, Any]) -> None:
    rows = arm.sample(3, seed=4)
    goals = arm.frames(rows)[:, :2, 3]
    path = ik.follow(list(goals), deadline=DEADLINE, **means)
    states = np.array([arm.actuator_states(row) for row in EVERY]).astype(int)
    near = [np.linalg.norm(arm.frames(EVERY)[:, :2, 3] - goal, axis=1) <= arm.tolerance for goal in goals]
    costs, before = np.zeros(1), arm.actuator_states(arm.home).astype(int)[None]
    for served in near:
        steps = (states[served][:, None] != before[None]).sum(axis=2)
        costs, before = (costs + steps).min(axis=1), states[served]
    assert path.certificate == "optimal"
    assert path.gap == 0.0
    assert path.switches == path.cost == path.bound == path.lower_bound == costs.min()


def test_deadlines_of_paths_are_positive(arm: hb.Arm, ik: hb.Solver) -> None:
    with pytest.raises(hb.GoalError, match="deadline: a positive number of seconds is needed, got 0"):
        ik.follow([arm.position(arm.home)], deadline=0)


def test_lines_between_goals_are_followed(arm: hb.Arm) -> None:
    ik = hb.Solver(arm)
    a = arm.position([4, 4, 4, 4])
    path = ik.follow([a, a + np.array([0.02, 0.01])], start=[4, 4, 4, 4], path_tolerance=0.05)
    assert len(path.solutions) >= 2
    assert path.waypoints[-1] == len(path.solutions) - 1


def test_every_method_answers(arm: hb.Arm, ik: hb.Solver) -> None:
    goal = arm.position([5, 2, 6, 1])
    found = {method: ik.solve(goal, method=method, deadline=DEADLINE) for method in hb.METHODS}
    assert all(solution.within_tolerance for solution in found.values())
    assert found["minimum-switch"].switches == min(solution.switches for solution in found.values())


def test_paths_have_orientations_and_locked_actuators(arm: hb.Arm) -> None:
    locked = arm.lock({"2.left": "extended"})
    goals = []
    for frame in locked.frames(locked.sample(3, seed=6)):
        angle = math.atan2(frame[1, 0], frame[0, 0])
        goals.append(hb.Goal(frame[:2, 3], angle, tolerance=0.02, angle_tolerance=0.1))
    path = hb.Solver(locked).follow(goals)
    place = arm.actuators.index("2.left")
    for goal, row in zip(goals, path.configurations, strict=True):
        frame = arm.frame(row)
        assert np.linalg.norm(frame[:2, 3] - goal.position) <= 0.02
        turned = math.atan2(frame[1, 0], frame[0, 0]) - goal.orientation
        assert abs(math.remainder(turned, 2 * math.pi)) <= 0.1
        assert arm.actuator_states(row)[place] == 1


def test_calibration_with_frames_keeps_locked_actuators(arm: hb.Arm) -> None:
    real = hb.Arm([hb.vgt("BC", width=0.202, lengths=(0.2, 0.251), count=4)], base=(0.02, 0.01))
    rows = arm.sample(40)
    fitted = hb.calibrate(arm.lock({"1.left": "extended"}), rows, real.frames(rows))
    assert fitted.report.after.position.rms < fitted.report.before.position.rms
    np.testing.assert_allclose(fitted.arm.frames(rows), real.frames(rows), atol=1e-4)
    assert fitted.arm.locked == {"1.left": "extended"}
    assert (fitted.arm.name, fitted.arm.tolerance) == ("short", 0.01)
