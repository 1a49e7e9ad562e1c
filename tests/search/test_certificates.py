"""Certificates against brute force, in random worlds with tips on their tolerance and bodies that touch obstacles."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hyperbit.controller.manipulator.frames import turned
from hyperbit.controller.manipulator.joints import prismatic
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.branch_and_bound import BranchAndBound
from hyperbit.controller.search.lists.two_list import ListSizes
from hyperbit.controller.search.method import switch_costs
from hyperbit.controller.search.solution import Incumbent, Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace import cost_to_go
from hyperbit.controller.workspace.hull import build_hull
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm, spatial_arm
from tests.search.worlds import (
    Goal,
    X,
    drawn_arm,
    drawn_clearance,
    drawn_goal,
    drawn_weights,
    least_cost,
    solver_of,
    with_locks,
)

FOREVER = 1e9  # [s]
SHORT = [  # lists so short that proofs need all stages: layers, look-ups, and a second band
    ListSizes(near, wide, 2 * wide, quarter, layer, at_once=3)
    for near, wide, quarter, layer in ((2, 6, 3, 1), (6, 40, 1000, 1), (12, 30, 8, 100))
]


def check(solver: Solver, goal: Goal, previous: np.ndarray, whole: bool = True) -> Solution:
    """Solves a goal and compares the certificate with brute force over all configurations.

    With `whole` the lists hold every configuration, so that the answer is proven.
    """
    found = solver.solve(solver.target(*goal), previous, timeout=60.0)
    least = least_cost(solver, goal, previous)
    if found.certificate == "optimal":
        assert found.within_tolerance
        assert found.cost == pytest.approx(least, rel=1e-9)
        assert found.lower_bound == pytest.approx(found.cost)
    elif found.certificate == "unreachable":
        assert (least, found.lower_bound) == (np.inf, np.inf)
        assert not found.within_tolerance
    else:
        assert not whole
        assert found.bound <= least * (1 + 1e-9)
    assert found.bound <= found.cost or not found.within_tolerance
    return found


@pytest.mark.parametrize("seed", range(300))
def test_no_certificate_is_false(seed: int) -> None:
    """Each second world has short lists."""
    rng = np.random.default_rng(seed)
    whole = drawn_arm(rng, space=seed % 4 > 1)
    arm = with_locks(whole, rng) if rng.random() < 0.3 else whole
    short = seed % 2 == 1
    sizes = SHORT[seed // 4 % 3] if short else ListSizes()
    solver = solver_of(arm, drawn_weights(arm, rng), drawn_clearance(arm, rng), sizes)
    for posed in (False, False, False, True):
        check(solver, drawn_goal(whole, rng, posed), rng.integers(0, arm.states), whole=not short)


@pytest.mark.parametrize("seed", range(20))
def test_branch_and_bound_alone_proves_each_pose(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost_to_go, "PREFIXES", (1.0, 30.0)[seed // 2 % 2])  # maps from the first level on, or later
    rng = np.random.default_rng(seed)
    whole = drawn_arm(rng, space=False)
    arm = with_locks(whole, rng) if seed % 4 == 0 else whole
    solver = solver_of(arm, drawn_weights(arm, rng), drawn_clearance(arm, rng))
    for _ in range(4):
        goal, previous = drawn_goal(whole, rng, posed=True), rng.integers(0, arm.states)
        target, incumbent = solver.target(*goal), Incumbent(previous, FOREVER)
        tree = BranchAndBound(arm, build_hull(arm))
        tree.run(target, previous, switch_costs(arm, previous, solver.weights), incumbent, FOREVER)
        least = least_cost(solver, goal, previous)
        assert incumbent.proven
        assert incumbent.cost == pytest.approx(least, rel=1e-9)
        assert least == np.inf or solver.described(incumbent.configuration, target, previous).within_tolerance


def test_a_tip_exactly_on_the_tolerance_counts_for_the_certificate_as_for_the_answer() -> None:
    arm = Manipulator([prismatic(X, (0.25, 0.5), np.eye(4))] * 2)
    found = check(solver_of(arm), (np.array((0.5, 0.0)), 0.25, np.inf), np.array((1, 1)))
    assert (found.switches, found.error, found.certificate) == (1, 0.25, "optimal")


@cache
def long_arm() -> Solver:
    arm = paper_arm(16)
    return Solver(arm, map_densities(arm, 0.05, 4000))


def test_the_lower_bound_does_not_fall_with_more_time():
    solver, rng = long_arm(), np.random.default_rng(0)
    for goal in solver.manipulator.tips(rng.integers(0, 8, (12, 16)))[:, :2, 3]:
        previous = rng.integers(0, 8, 16)
        bounds = [
            solver.solve(solver.target(goal, 2e-3), previous, timeout=t).lower_bound or 0.0 for t in (2e-3, 3e-2, 2.0)
        ]
        costs = [solver.solve(solver.target(goal, 2e-3), previous, timeout=2.0).cost]
        assert max(bounds) <= costs[0] + 1e-9


def test_goals_of_a_wrong_dimension_are_refused():
    flat, space = solver_of(paper_arm(2)), solver_of(spatial_arm(2))
    for solver, goal in ((flat, (0.1, 0.2, 0.3)), (flat, (0.1,)), (space, (0.1, 0.2)), (space, np.eye(3))):
        with pytest.raises(ValueError, match="goal"):
            solver.solve(solver.target(goal, 0.01), np.zeros(2, dtype=np.int64))
    tilted = turned(X, 0.1)
    with pytest.raises(ValueError, match="plane"):
        flat.solve(flat.target(tilted, 0.01), np.zeros(2, dtype=np.int64))


def test_paper_methods_prove_nothing():
    solver, goal = long_arm(), (0.55, 2.9)
    found = solver.solve(solver.target(goal, 2e-3), np.zeros(16, dtype=np.int64), "ipop-previous")
    assert (found.certificate, found.optimal, found.lower_bound) == ("unknown", None, None)
    assert (
        solver.solve(solver.target((90.0, 0.0), 2e-3), found.configuration, "ipop-previous").reach
        == "seems out of reach"
    )
    assert solver.solve(solver.target((90.0, 0.0), 2e-3), found.configuration).reach == "is out of reach"
    same = solver.solve(solver.target(found.tip[:2, 3], 2e-3), found.configuration, "ipop-previous")
    assert (same.certificate, same.optimal, same.lower_bound) == ("optimal", True, 0.0)
