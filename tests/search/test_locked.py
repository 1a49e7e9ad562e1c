"""All searches on arms with locked actuators: modules have different numbers of states, some only one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.search.method import METHODS
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm
from tests.manipulator.test_locked import locked_arms
from tests.search.worlds import solver_of


@settings(max_examples=40)
@given(locked_arms(), st.integers(0, 2**32 - 1), st.sampled_from(METHODS[1:]))
def test_the_papers_methods_reach_what_a_tip_of_the_arm_that_is_left_marks(case, seed, method):
    arm, locked = case
    reduced = lock_actuators(arm, locked)
    rng = np.random.default_rng(seed)
    goal = reduced.tip(rng.integers(0, reduced.states))[: reduced.dimension, 3]
    solver = solver_of(reduced)
    found = solver.solve(solver.target(goal, 1e-6), rng.integers(0, reduced.states), method)
    if np.prod(reduced.states.astype(float)) <= 2**16:  # in the exact table, whole
        assert found.error <= 1e-6


@pytest.mark.parametrize("freed", [0, 1, 4, 10])
def test_many_ways_along_a_trajectory_are_found_where_few_actuators_are_free(freed):
    arm = paper_arm(6)
    rng = np.random.default_rng(freed)
    locked = rng.integers(0, 2, 18).astype(np.int8)
    locked[rng.choice(18, freed, replace=False)] = -1
    reduced = lock_actuators(arm, locked)
    solver = Solver(reduced, map_densities(reduced, 0.02, 4000), list_whole=False)
    solver.prepare()
    start = np.zeros(6, dtype=np.int64)
    for _ in solver.expect(start, 0.01):
        pass
    tips = reduced.tips(rng.integers(0, reduced.states, (5, 6)))[:, :2, 3]
    search = LabelSetting(solver, list(TrajectoryPoints(solver, through(np.arange(5.0), tips, 0.01))), start)
    search.narrow(64)
    way = search.best.configurations
    assert way is not None
    assert all(np.linalg.norm(reduced.tip(c)[:2, 3] - tip) <= 0.01 for c, tip in zip(way, tips, strict=True))
    assert len(every_configuration(reduced)) == 2**freed
