"""Foundations of the comparison: the proof is correct, and each method returns valid configurations."""

from itertools import product

import numpy as np
import pytest

from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm
from tests.benchmarks.search.methods import METHODS, OPTIMUM, two_list

TOLERANCE = 0.01


def test_the_proof_agrees_with_trying_every_configuration():
    arm = paper_arm(4)
    problem, every = OPTIMUM.prepare(arm, None), every_configuration(arm)
    tips = arm.tips(every)[:, :2, 3]
    rng = np.random.default_rng(0)
    for goal, previous in product(tips[rng.integers(len(tips), size=6)], every[rng.integers(len(every), size=6)]):
        near = every[np.linalg.norm(tips - goal, axis=1) <= TOLERANCE]
        fewest = min(arm.switches(previous, own) for own in near)
        found = OPTIMUM.solve(problem, goal, previous, TOLERANCE)
        assert arm.switches(previous, found) == fewest
        assert np.linalg.norm(arm.tip(found)[:2, 3] - goal) <= TOLERANCE


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_a_method_answers_with_a_configuration_and_leaves_the_previous_one(method):
    arm = paper_arm(6)
    problem = method.prepare(arm, map_densities(arm, 0.02, 100_000))
    previous = np.arange(6)
    for goal in arm.tips(np.random.default_rng(1).integers(0, 8, (5, 6)))[:, :2, 3]:
        found = method.solve(problem, np.ascontiguousarray(goal), previous, TOLERANCE)
        assert found.shape == (6,)
        assert np.all((found >= 0) & (found < 8))
    assert previous.tolist() == [0, 1, 2, 3, 4, 5]


def test_the_list_of_a_half_is_complete_without_duplicates():
    arm = paper_arm(6)
    problem, previous = two_list.prepare(arm, None, 3), np.array([1, 7, 0, 2, 5, 4])
    problem.upper.list((0.0, 0.0), problem.arm.costs(previous), 3)
    found = set()
    for row in range(problem.upper.count):
        own = previous.copy()
        problem.upper.write(problem.upper.codes[row], own)
        assert arm.switches(own, previous) == problem.upper.prices[row] <= 3
        found.add(tuple(own))
    assert len(found) == problem.upper.count == 1 + 9 + 36 + 84
