"""The hull of all tips, and the nearest configuration if none is within the tolerance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.hull import Hull
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm, short_arms, spatial_arm


@settings(max_examples=40)
@given(short_arms(most=4), st.integers(0, 2**32 - 1))
def test_no_tip_is_excluded(arm, seed):
    hull = Hull(arm)
    for configuration in np.random.default_rng(seed).integers(0, arm.states, (30, len(arm.states))):
        assert not hull.excludes(arm.tip(configuration)[:3, 3], 0.0)
        assert np.linalg.norm((arm.tip(configuration) - arm.base)[:3, 3]) <= 1.01 * hull.reach


@pytest.mark.parametrize(("arm", "axis"), [(paper_arm(16), 1), (spatial_arm(16), 2)], ids=["planar", "spatial"])
def test_what_is_just_beyond_the_straight_arm_is_excluded(arm, axis):
    top = max(arm.tip(np.full(16, state))[axis, 3] for state in range(arm.states[0]))
    hull = Hull(arm)
    for beyond, excluded in ((0.001, False), (0.003, True)):
        assert hull.excludes(np.eye(3)[axis] * (top + beyond), 0.002) == excluded


def test_a_goal_surely_out_of_reach_is_told_so(arm, densities):
    for goal in ((6.0, 6.0), (9.0, 9.0), (0.0, -2.0), (0.0, 3.67)):
        solver = Solver(arm.manipulator, densities)
        found = solver.solve(solver.target(goal, 0.002), np.zeros(16, dtype=np.int64))
        assert found.lower_bound == np.inf
        assert not found.within_tolerance


@pytest.mark.parametrize(("arm", "most"), [(paper_arm(6), 1.0), (spatial_arm(6), 1.01)], ids=["planar", "spatial"])
def test_what_cannot_be_reached_is_approached_as_near_as_brute_force_knows(arm, most):
    """The nearest configuration exactly, or within 1 % for arms with more configurations than one search lists."""
    solver = Solver(arm, map_densities(arm, 0.02, 200_000))
    tips = arm.tips(every_configuration(arm))[:, :3, 3]
    low, high = tips.min(axis=0) - 0.3, tips.max(axis=0) + 0.3
    for goal in np.random.default_rng(0).uniform(low, high, (60, 3)):
        nearest = np.linalg.norm(tips - goal, axis=1).min()
        found = solver.solve(solver.target(goal[: arm.dimension], 1e-5), np.zeros(6, dtype=np.int64), timeout=10.0)
        assert found.error <= most * nearest + 1e-9


def test_the_papers_arm_comes_as_near_as_its_hull_allows(solver):
    """For a convex workspace no configuration is nearer than the hull."""
    hull = Hull(solver.manipulator)
    for angle in np.linspace(0.8, 2.3, 16):
        goal = 6.0 * np.array([np.cos(angle), np.sin(angle), 0.0])
        error = solver.solve(solver.target(goal[:2], 0.002), np.zeros(16, dtype=np.int64), timeout=10.0).error
        assert hull.excludes(goal, error - 0.02)
