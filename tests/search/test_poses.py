"""Goals with orientation against brute force, on arms with few configurations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.bench import goal_sets
from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.manipulator.frames import Frame, turned
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.branch_and_bound import BranchAndBound
from hyperbit.controller.search.lists.two_list import TwoList
from hyperbit.controller.search.method import METHODS, switch_costs
from hyperbit.controller.search.search_time import SearchTime
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.search.target import SearchTarget
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm, spatial_arm
from tests.search.worlds import solver_of


def missed(arm: Manipulator, configurations: np.ndarray, goal: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) and angles (n,) of tips from a pose."""
    tips = arm.tips(configurations)
    return np.linalg.norm(tips[:, :3, 3] - goal[:3, 3], axis=1), np.array([angle_between(tip, goal) for tip in tips])


def near(arm: Manipulator, rng: np.random.Generator, tolerance: float, turn: float) -> Frame:
    """A pose near the tip of a random configuration, within the tolerances or slightly outside."""
    axis = (0, 0, 1) if arm.planar else rng.normal(size=3)
    goal = arm.tip(rng.integers(0, arm.states)) @ turned(axis, turn * rng.uniform(-1.2, 1.2))
    goal[:3, 3] += rng.normal(0, tolerance / 2, 3) * (1, 1, not arm.planar)
    return goal


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("arm", [paper_arm(5), spatial_arm(5)], ids=["planar", "spatial"])
def test_every_method_comes_to_a_pose_that_the_table_holds(arm, method):
    """All modules are in the distal table or enumerated below it, so that only its comparison decides."""
    solver, rng = solver_of(arm), np.random.default_rng(2)
    previous = rng.integers(0, arm.states)
    for goal in arm.tips(rng.integers(0, arm.states, (20, 5))):
        found = solver.solve(solver.target(goal, 1e-6, 1e-6), previous, method)
        assert found.within_tolerance
        previous = found.configuration


@pytest.mark.parametrize("method", METHODS)
def test_every_method_comes_to_poses_of_the_papers_arm(arm, densities, method):
    solver, rng = Solver(arm.manipulator, densities), np.random.default_rng(11)
    previous = rng.integers(0, 8, 16)
    for goal in arm.manipulator.tips(rng.integers(0, 8, (10, 16))):
        found = solver.solve(solver.target(goal, 0.005, 0.03), previous, method, SearchTime(0.05, unfound=10.0))
        assert found.within_tolerance
        previous = found.configuration


def test_long_arms_keep_both_tolerances_and_claim_no_false_bound(arm, densities):
    solver, rng = Solver(arm.manipulator, densities), np.random.default_rng(7)
    previous = rng.integers(0, 8, 16)
    for goal in arm.manipulator.tips(rng.integers(0, 8, (8, 16))):
        position = solver.solve(solver.target(goal[:2, 3], 0.005), previous, timeout=2.0)
        found = solver.solve(solver.target(goal, 0.005, 0.03), previous, timeout=2.0)
        assert found.within_tolerance
        assert found.error <= 0.005
        assert found.angle <= 0.03
        assert angle_between(found.tip, goal) == pytest.approx(found.angle)
        assert found.bound <= found.cost
        assert position.bound <= found.cost  # what is asked more costs no less
        previous = found.configuration


def test_whatever_orientation_will_do_is_a_goal_of_position(arm, densities):
    solver, rng = Solver(arm.manipulator, densities), np.random.default_rng(4)
    previous = rng.integers(0, 8, 16)
    for goal in arm.manipulator.tips(rng.integers(0, 8, (5, 16))):
        plain = solver.solve(solver.target(goal[:2, 3], 0.005), previous, timeout=10.0)
        whole = solver.solve(solver.target(goal, 0.005, np.pi), previous, timeout=10.0)
        assert whole.configuration.tolist() == plain.configuration.tolist()
        assert whole.angle == 0
        previous = plain.configuration


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_a_meeting_cut_short_says_what_it_left_out(seed):
    rng = np.random.default_rng(seed)
    arm = (paper_arm(4), spatial_arm(4))[seed % 2]
    centre, goal = rng.integers(0, arm.states), near(arm, rng, 0.05, 0.3)
    target = SearchTarget(goal, goal, arm, 0.05, 0.3, 0.05 / 0.3)
    costs = switch_costs(arm, centre, arm.per_module(np.ones(len(arm.actuators))))
    both = TwoList(arm, 1000, matched=5)
    both.list(centre, costs, costs)
    cut, whole = Incumbent(centre, 0.0), Incumbent(centre, np.inf)
    assert both.match(target, cut) == (False, both.lower.costs[5:].min())
    assert both.match(target, whole) == (True, min(both.lower.unexplored, both.upper.unexplored))
    assert whole.cost >= min(cut.cost, both.lower.costs[5:].min())


def test_a_pose_is_reached_even_if_branch_and_bound_takes_all_the_time_it_is_given(monkeypatch):
    def run(tree, target, seed, costs, incumbent, until):
        if until >= incumbent.until:
            incumbent.until = 0.0

    monkeypatch.setattr(BranchAndBound, "begun", True)
    monkeypatch.setattr(BranchAndBound, "run", run)
    task = goal_sets.read("paper-poses")[132]
    arm = goal_sets.load_arm(task.arm).manipulator
    solver = Solver(arm, map_densities(arm, 0.02, 1 << 18), list_whole=False)
    asked = solver.target(task.frame, task.tolerance, task.angle_tolerance)
    solution = solver.solve(asked, task.start, timeout=SearchTime(0.05, unfound=600.0))
    assert solution.within_tolerance
