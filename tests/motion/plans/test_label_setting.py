"""Whole trajectories: the optimum compared with brute force on small arms, and valid bounds."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator.joints import prismatic
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.plans import label_setting
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.plans.whole import plan_whole
from hyperbit.controller.motion.trajectory import Trajectory, through
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.neighbours import counts
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm, short_arms, spatial_arm
from tests.motion.plans.exact_trajectories import Case, least_cost, random_case

POINTS = np.array([(0.3, 2.6), (0.2, 2.5)])
LONG = 3600.0  # [s], far more than small arms take on any machine; a proof ends the search before


def search_of(case: Case, stop: Callable[[], bool] = lambda: False, **more: int) -> LabelSetting:
    return LabelSetting(case.solver, list(TrajectoryPoints(case.solver, case.trajectory)), case.start, stop, **more)


def check(case: Case, **more: int) -> None:
    """Checks that the search proves the optimum, and that its earlier bounds are valid."""
    solver, trajectory, start, _ = case
    least = least_cost(case)
    search = search_of(case, **more)
    assert search.best.bound <= least + 1e-9
    found = search.run(LONG)
    assert search.optimal
    assert found.cost == pytest.approx(least, rel=1e-9)
    assert found.bound == pytest.approx(least, rel=1e-9)
    if least == np.inf:
        return
    rows = np.vstack([start, found.configurations])
    assert sum(solver.cost(a, b) for a, b in pairwise(rows)) == pytest.approx(found.cost)
    for k, row in enumerate(found.configurations):
        if k not in trajectory.fixed:
            tolerance, turn = float(trajectory.tolerances[k]), float(trajectory.turns[k])
            assert solver.described(row, solver.target(trajectory.goal(k), tolerance, turn), row).within_tolerance


def whole_case(solver: Solver, trajectory: Trajectory, start: np.ndarray) -> Case:
    return Case(solver, trajectory, start, every_configuration(solver.manipulator))


@pytest.mark.timeout(600)
@settings(max_examples=20, deadline=None)
@given(arm=short_arms(most=3), seed=st.integers(0, 2**32 - 1), weighted=st.sampled_from([0, 1, 2]))
def test_the_optimum_of_small_arms_is_found_and_proven(arm, seed, weighted):
    rng = np.random.default_rng(seed)
    weights = [None, rng.uniform(0.5, 3.0, len(arm.actuators)), rng.integers(1, 4, len(arm.actuators))][weighted]
    solver = Solver(arm, map_densities(arm, 0.1, 1 << 16), weights, list_whole=False)
    path = np.array([rng.integers(0, arm.states) for _ in range(5)])
    tips = arm.tips(path)
    noise = rng.normal(size=(5, arm.dimension)) * 0.01
    turns = np.where(rng.random(5) < 0.3, 0.3, np.inf)
    trajectory = through(np.arange(5.0), tips[:, : arm.dimension, 3] + noise, 0.1, None, tips[:, :3, :3], turns)
    check(whole_case(solver, trajectory, path[0]))


@pytest.mark.parametrize("goal", [0.4, 0.6, 0.7, 0.8, 0.9, 1.0])
def test_cheaper_tips_one_float_beyond_the_tolerance_do_not_keep_the_optimum_from_its_proof(goal):
    """Some tips are 0.30000000000000004 away from 0.4, 0.8, 0.9 and 1.0."""
    arm = Manipulator([prismatic((1, 0, 0), (0.0, 0.1), np.eye(4))] * 8)
    solver = Solver(arm, map_densities(arm, 0.05, 1 << 12), list_whole=False)
    trajectory = through(np.arange(2.0), np.array([(0.2, 0.0), (goal, 0.0)]), 0.3)
    check(whole_case(solver, trajectory, np.zeros(8, dtype=np.int64)))


@pytest.mark.parametrize("arm", [paper_arm(3), spatial_arm(3)], ids=["planar", "spatial"])
def test_arms_that_hold_a_configuration_for_several_points(arm):
    rng = np.random.default_rng(4)
    solver = Solver(arm, map_densities(arm, 0.05, 1 << 16), list_whole=False)
    ends = arm.tips([rng.integers(0, arm.states) for _ in range(2)])[:, : arm.dimension, 3]
    points = ends[0] + np.linspace(0, 1, 12)[:, None] * (ends[1] - ends[0])
    check(whole_case(solver, through(np.arange(12.0), points, 0.15), np.zeros(3, dtype=np.int64)))


def test_points_that_are_configurations_are_kept():
    arm, rng = paper_arm(3), np.random.default_rng(7)
    solver = Solver(arm, map_densities(arm, 0.05, 1 << 16), list_whole=False)
    path = np.array([rng.integers(0, arm.states) for _ in range(4)])
    positions = arm.tips(path)[:, :2, 3]
    given_states = {1: arm.actuator_states(path[1]), 3: arm.actuator_states(path[3])}
    plain = through(np.arange(4.0), positions, 0.02)
    trajectory = Trajectory(**{**vars(plain), "fixed": given_states})
    check(whole_case(solver, trajectory, path[0]))


def test_without_time_nothing_wrong_is_claimed(arm, densities):
    solver = Solver(arm.manipulator, densities)
    points = np.array([[0.3, 2.6], [0.32, 2.6], [0.34, 2.6]])
    trajectory = through(np.arange(3.0), points, 0.002)
    found = LabelSetting(solver, list(TrajectoryPoints(solver, trajectory)), np.zeros(16, dtype=np.int64)).run(0.0)
    assert found.configurations is None
    assert found.bound == 3.0


@pytest.mark.parametrize("seed", range(12))
def test_the_optimum_is_found_and_proven_with_locks_obstacles_and_orientations(seed):
    check(random_case(seed, 1 << 13), threads=2)


def labels_only(search: LabelSetting, stop=lambda: False) -> None:
    search.to_go.list_tips(1.0)
    search.to_go.sweep(search._start, np.inf, 0.5, stop)


@pytest.mark.parametrize("paired", [False, True], ids=["near each", "pairs of lists"])
@pytest.mark.parametrize("seed", range(20, 28))
def test_labels_alone_give_valid_bounds(seed, paired, monkeypatch):
    if paired:  # pairs cost nothing
        monkeypatch.setattr(counts, "JOINED", 0.0)
        monkeypatch.setattr(counts, "LOOKUP", 0.0)
    case = random_case(seed, 1 << 13)
    search = search_of(case, threads=2)
    labels_only(search)
    assert search.first_bound() <= least_cost(case) * (1 + 1e-9)


def test_a_cancel_while_labels_are_computed_keeps_what_is_proven():
    case = random_case(1, 1 << 13)
    calls = iter(range(10**9))
    search = search_of(case, lambda: next(calls) > 3)
    labels_only(search, search._late)
    assert 0 < search.first_bound() <= least_cost(case) * (1 + 1e-9)


def test_what_a_cancel_raises_ends_all_threads():
    case = random_case(1, 1 << 13)

    def cancel() -> bool:
        raise KeyboardInterrupt

    search = search_of(case, cancel, threads=2)
    with pytest.raises(KeyboardInterrupt):
        search.run(LONG)


def long_search(solver: Solver, stop=lambda: False, points=((0.3, 2.6), (0.2, 2.5), (0.1, 2.4), (0.0, 2.3))):
    """Returns the search over a trajectory of the paper's arm, which takes minutes to prove."""
    trajectory = through(np.arange(float(len(points))), np.array(points), 0.002)
    return LabelSetting(solver, list(TrajectoryPoints(solver, trajectory)), np.zeros(16, dtype=np.int64), stop)


PHASES = {  # function, and how often it is called before
    "narrow layers": ("_widen", 0),
    "a proof": ("prove", 0),
    "labels": ("sweep", 0),
    "narrow layers with labels": ("_widen", 1),
    "a proof with labels": ("prove", 1),
}


@pytest.mark.parametrize("phase", PHASES)
def test_a_cancel_ends_each_phase_and_keeps_what_is_proven(arm, densities, monkeypatch, phase):
    monkeypatch.setattr(label_setting, "LEAST_SWEEP", 0.0)
    solver, cancelled, asked = Solver(arm.manipulator, densities), list[bool](), list[bool]()
    name, before = PHASES[phase]

    def stop() -> bool:
        asked.extend(cancelled)
        return bool(cancelled)

    search = long_search(solver, stop)
    owner, calls = (search.to_go if name == "sweep" else search), list[None]()
    original, bound = getattr(owner, name), search.best.bound

    def begun(*arguments):
        calls.append(None)
        if len(calls) > before and not cancelled:
            cancelled.append(True)
        return original(*arguments)

    monkeypatch.setattr(owner, name, begun)
    found = search.run(2.0)
    assert asked
    assert bound <= found.bound <= found.cost
    assert found.cost == np.inf or found.configurations is not None


def test_a_point_out_of_reach_in_the_middle_is_named_and_ends_no_search_in_an_error(arm, densities):
    solver = Solver(arm.manipulator, densities)
    points = [(0.3, 2.6), (9.0, 9.0), (0.2, 2.6)]
    found = long_search(solver, points=points).run(0.5)
    assert found.configurations is None
    assert found.bound >= 3.0
    planner = TransitionPlanner(solver, through(np.arange(3.0), np.array(points), 0.002))
    with pytest.raises(Refusal, match=r"waypoint 2, position"):
        plan_whole(planner, np.zeros(16, dtype=np.int64), "minimum-switch")


def test_with_a_deadline_that_is_over_the_first_plan_and_a_bound_are_given(arm, densities):
    planner = TransitionPlanner(Solver(arm.manipulator, densities), through(np.arange(2.0), POINTS, 0.002))
    found = plan_whole(planner, np.zeros(16, dtype=np.int64), "minimum-switch", deadline=1e-9)
    assert all(solution.within_tolerance for solution in found.solutions)
    assert 0 < found.bound <= found.cost


def test_two_proofs_at_once_prove_what_each_proves_alone():
    cases = [random_case(seed, 1 << 13) for seed in (1, 3)]

    def proof(case) -> tuple[float, float]:
        found = search_of(case, threads=2).run(LONG)
        return found.cost, found.bound

    with ThreadPoolExecutor(2) as pool:
        for case, (cost, bound) in zip(cases, pool.map(proof, cases), strict=True):
            assert cost == pytest.approx(least_cost(case))
            assert bound == pytest.approx(cost)


def test_without_memory_for_labels_what_is_proven_stays(monkeypatch):
    case = random_case(2, 1 << 13)
    search, swept = search_of(case), list[bool]()

    def fail(*_: object) -> None:
        swept.append(True)
        raise MemoryError

    monkeypatch.setattr(search.to_go, "sweep", fail)
    monkeypatch.setattr(search, "prove", lambda: None)  # it would end the search before
    found = search.run(LONG)
    assert swept
    assert 0 < found.bound <= least_cost(case) * (1 + 1e-9)


def test_ten_thousand_equal_points_need_no_switch_after_the_first(arm, densities):
    solver = Solver(arm.manipulator, densities)
    points = np.tile(arm.manipulator.tip(np.zeros(16, dtype=np.int64))[:2, 3], (10_000, 1))
    trajectory = through(np.arange(10_000.0), points, 0.002)
    search = LabelSetting(solver, list(TrajectoryPoints(solver, trajectory)), np.zeros(16, dtype=np.int64))
    assert search.best.bound == 0.0
    assert search.to_go.labels.last[0] == 9_999
    some = LabelSetting(solver, list(TrajectoryPoints(solver, trajectory))[:1000], np.zeros(16, dtype=np.int64))
    some.narrow(4)
    assert (some.best.cost, some.best.bound) == (0.0, 0.0)


def test_ten_thousand_points_are_searched_within_their_memory(arm, densities):
    """Without time for them all, a bound is known."""
    solver, turns = Solver(arm.manipulator, densities), np.linspace(0, 20 * np.pi, 10_000)
    points = np.column_stack((0.2 + 0.3 * np.cos(turns), 2.4 + 0.2 * np.sin(turns)))
    search = long_search(solver, points=points)
    found = search.run(1.0)
    assert found.bound >= 2_000
