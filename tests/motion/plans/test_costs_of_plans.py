"""Switches, cost, bound and certificate of a plan are of the stages that it carries out, those of detours included."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.plans import point_by_point
from hyperbit.controller.motion.plans.plan import TrajectoryPlan
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.plans.whole import WHOLE_TIME, look_ahead, plan_whole
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.trajectory import Trajectory, through
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import NONE, sphere
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.search_time import search_time
from hyperbit.controller.search.solution import EPSILON
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration
from tests.obstacles.moving import arm, hinge, truss

HINGES = arm([hinge(0.0, 2.4, 1.0), hinge(0.0, 2.4, 1.0)])
POST = BodyClearance(HINGES, sphere("disc 'post'", (0.29, 1.675), 0.1))
FOLDED, TURNED = np.array([0, 0]), np.array([1, 0])  # on the way the second hinge must fold past the post, and back
WEIGHTS = (2.0, 3.0)
DETOUR = 2.0 + 2 * 3.0

TRUSSES = arm([truss("BC" if k % 2 == 0 else "AD", 0.2, 0.2, 0.25) for k in range(3)])
EVERY = every_configuration(TRUSSES)
TIPS = TRUSSES.tips(EVERY)[:, :2, 3]
TOLERANCE = 0.03
PATIENT = 60.0  # [s], so that a busy machine finds as much as an idle one
SHORT = 0.5  # [s]: what holds of a plan, holds of a short search, too


@pytest.fixture(autouse=True, scope="module")
def patient() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(point_by_point, "WAY_TIME", PATIENT)
        yield


@pytest.fixture(scope="module")
def hinges() -> Solver:
    return Solver(HINGES, map_densities(HINGES, 0.05, 10_000), WEIGHTS, POST)


@pytest.fixture(scope="module")
def trusses() -> Solver:
    return Solver(TRUSSES, map_densities(TRUSSES, 0.01, 10_000), 1.0 + np.arange(9) % 3)


def goals_at(manipulator: Manipulator, *configurations: Configuration, fixed: bool = False) -> Trajectory:
    tips = manipulator.tips(configurations)[:, :2, 3]
    trajectory = through(np.arange(float(len(tips))), tips, 0.01)
    states = {k: manipulator.actuator_states(c) for k, c in enumerate(configurations)}
    return replace(trajectory, fixed=states) if fixed else trajectory


def carried_out(manipulator: Manipulator, start: Configuration, found: TrajectoryPlan) -> list[np.ndarray]:
    """How often each actuator switches on the way to each point, shape (A,) each."""
    counts, before = [], manipulator.actuator_states(start)
    for transition in found.transitions:
        rows = np.vstack([before, transition.stages]).astype(int)
        counts.append(np.abs(np.diff(rows, axis=0)).sum(axis=0))
        before = transition.stages[-1]
    return counts


@pytest.mark.parametrize("fixed", [False, True])
def test_a_detour_is_counted_in_switches_and_cost_and_is_not_optimal(hinges: Solver, fixed: bool) -> None:
    planner = TransitionPlanner(hinges, goals_at(HINGES, TURNED, fixed=fixed), Pace(0.06))
    found = PointByPoint(planner, "minimum-switch", search_time(PATIENT)).plan(FOLDED)
    (solution,) = found.solutions
    assert solution.configuration.tolist() == TURNED.tolist()
    assert (solution.switches, solution.cost) == (found.switches, found.cost) == (3, DETOUR)
    assert (found.certificate, found.bound) == (solution.certificate, solution.bound) == ("bound", 2.0)


def test_a_whole_plan_is_not_optimal_because_its_configurations_are(hinges: Solver) -> None:
    planner = TransitionPlanner(hinges, goals_at(HINGES, TURNED), Pace(0.06))
    found = plan_whole(planner, FOLDED, "minimum-switch", per_switch=PATIENT)
    assert (found.switches, found.cost, found.bound, found.certificate) == (3, DETOUR, 2.0, "bound")
    assert found.solutions[0].proof() == found.proof()


def test_a_detour_after_the_first_point_is_counted(hinges: Solver) -> None:
    goals = goals_at(HINGES, FOLDED, TURNED, TURNED)
    found = plan_whole(TransitionPlanner(hinges, goals, Pace(0.06)), FOLDED, "minimum-switch", per_switch=PATIENT)
    assert [solution.switches for solution in found.solutions] == [0, 3, 0]
    assert [solution.certificate for solution in found.solutions] == ["optimal", "bound", "optimal"]
    assert (found.switches, found.cost, found.certificate) == (3, DETOUR, "bound")


def test_a_fixed_configuration_reached_without_a_detour_is_optimal(hinges: Solver) -> None:
    free = hinges.avoiding(None)
    planner = TransitionPlanner(free, goals_at(HINGES, TURNED, fixed=True), Pace(0.06))
    found = PointByPoint(planner, "minimum-switch", search_time(PATIENT)).plan(FOLDED)
    assert (found.switches, found.cost, found.certificate) == (1, 2.0, "optimal")


def test_a_waypoint_keeps_its_proof_when_others_change(trusses: Solver) -> None:
    rng = np.random.default_rng(4)
    start, *points = EVERY[rng.integers(len(EVERY), size=4)]
    goals = goals_at(TRUSSES, *points)
    planner = TransitionPlanner(trusses, goals, Pace(0.06))
    found = PointByPoint(planner, "minimum-switch", search_time(PATIENT)).plan(start)
    same = found.improved(planner, 0, [s.configuration for s in found.solutions], start)
    assert [s.proof() for s in same.solutions] == [s.proof() for s in found.solutions]
    other = found.improved(planner, 0, [points[0]], start)
    assert other.solutions[0].bound == found.solutions[0].bound


@settings(max_examples=40)
@given(st.integers(0, 2**32), st.booleans(), st.sampled_from([None, 2]), st.integers(1, 3))
def test_a_plan_is_what_it_says(trusses: Solver, seed: int, among: bool, inrush: int | None, count: int) -> None:
    rng = np.random.default_rng(seed)
    centre = TIPS[rng.integers(len(TIPS))] + rng.normal(0, 0.1, 2)
    clearance = BodyClearance(TRUSSES, sphere("disc", centre, 0.06) if among else NONE)
    solver, free = trusses.avoiding(clearance if among else None), EVERY[~clearance.blocked(EVERY)]
    start, *points = free[rng.integers(len(free), size=1 + count)]
    goals = through(np.arange(float(count)), TRUSSES.tips(points)[:, :2, 3], TOLERANCE)
    planner = TransitionPlanner(solver, goals, Pace(0.06, inrush))
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(point_by_point, "WAY_TIME", 0.1)
            found = PointByPoint(planner, "minimum-switch", search_time(SHORT)).plan(start)
    except Refusal:
        return
    for each in (found, look_ahead(planner, found, start, WHOLE_TIME)):
        before = start
        for k, (solution, counts) in enumerate(zip(each.solutions, carried_out(TRUSSES, start, each), strict=True)):
            assert solution.switches == counts.sum()
            assert solution.cost == pytest.approx((solver.weights * TRUSSES.per_module(counts)).sum())
            near = np.linalg.norm(TRUSSES.tips(free)[:, :2, 3] - goals.positions[k], axis=1) <= TOLERANCE
            least = solver.cost(free[near], before).min()
            assert solution.bound <= least * (1 + EPSILON)
            assert solution.certificate != "optimal" or solution.cost <= least * (1 + EPSILON)
            before = solution.configuration
        assert each.switches == sum(solution.switches for solution in each.solutions)
        assert each.cost == pytest.approx(sum(solution.cost for solution in each.solutions))
        assert each.certificate != "optimal" or each.cost <= each.bound * (1 + EPSILON)
        if count == 1:
            assert each.bound <= least * (1 + EPSILON)
            assert each.proof() == each.solutions[0].proof()
