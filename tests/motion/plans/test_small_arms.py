"""Small arms: each goal and trajectory is proven, and no certificate is false, listed whole or not."""

import numpy as np
import pytest

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.search import solver as search
from hyperbit.controller.search.search_time import search_effort
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm
from tests.benchmarks.proofs.small_arms import SmallArm, followed, solved

LONG = 600.0  # [s], far more than any answer takes


def solver_of(arm: Manipulator, list_whole: bool = True) -> Solver:
    return Solver(arm, map_densities(arm, arm.length / 20, 4000), list_whole=list_whole)


@pytest.mark.parametrize("seed", range(16))
def test_each_answer_of_an_arm_that_is_listed_whole_is_proven(seed):
    small = SmallArm(seed)
    solved(small, True, LONG)
    followed(small, True, LONG)


@pytest.mark.parametrize("seed", range(16, 28))
def test_no_answer_of_the_searches_for_larger_arms_is_false(seed):
    small = SmallArm(seed)
    solved(small, False, 0.05)
    followed(small, False, 0.2)


def test_only_arms_with_few_configurations_are_listed(monkeypatch):
    assert solver_of(paper_arm(2)).enumeration is not None
    assert solver_of(paper_arm(2), list_whole=False).enumeration is None
    monkeypatch.setattr(search, "LISTED_WHOLE", 63)
    assert solver_of(paper_arm(2)).enumeration is None


def test_a_list_of_all_is_paid_for_by_its_length():
    spent = [
        solver.solve(solver.target((9.0, 9.0), 0.1), np.zeros(n, dtype=np.int64), timeout=search_effort(1.0)).effort
        for n in (2, 4)
        for solver in [solver_of(paper_arm(n))]
    ]
    assert spent[0] < spent[1]


@pytest.mark.parametrize(("seconds", "stopped"), [(0.0, False), (LONG, True)])
def test_without_time_not_all_sequences_are_tried(seconds, stopped):
    arm, start = paper_arm(3), np.zeros(3, dtype=np.int64)
    solver, tips = solver_of(arm), arm.tips(np.array([(1, 2, 3), (7, 7, 7)]))[:, :2, 3]
    points = list(TrajectoryPoints(solver, through(np.arange(2.0), tips, 0.01)))
    tried = LabelSetting(solver, points, start, lambda: stopped)
    assert not tried.try_all(seconds)
    assert tried.run(seconds).bound <= LabelSetting(solver, points, start).run(LONG).cost
