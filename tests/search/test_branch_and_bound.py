"""Branch and bound alone, without lists: its answers and proofs are those of trying every configuration."""

from __future__ import annotations

import numpy as np
import pytest

from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.search.branch_and_bound import BranchAndBound
from hyperbit.controller.search.method import switch_costs
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace import cost_to_go
from hyperbit.controller.workspace.hull import build_hull
from tests.arms import paper_arm
from tests.search.test_certificates import any_arm, lattice_arm, least_cost, obstacle, pose_on_the_shell, solver_of

FOREVER = 1e9  # [s]


def planar_arm(rng: np.random.Generator) -> Manipulator:
    while True:
        arm = (lattice_arm, any_arm, lambda rng: paper_arm(4))[rng.integers(3)](rng)
        if arm.planar:
            return arm


def held_arm(arm: Manipulator, rng: np.random.Generator) -> Manipulator:
    held = np.where(rng.random(len(arm.actuators)) < 0.2, arm.actuator_states(rng.integers(0, arm.states)), -1)
    try:
        return lock_actuators(arm, held.astype(np.int8))
    except ValueError:
        return arm  # a module has no such state


def check(solver: Solver, goal: np.ndarray, previous: np.ndarray, tolerance: float, turn: float) -> None:
    arm = solver.manipulator
    tree, target = BranchAndBound(arm, build_hull(arm)), solver.target(goal, tolerance, turn)
    costs = switch_costs(arm, previous, solver.weights)
    incumbent = Incumbent(previous, FOREVER)
    tree.run(target, previous, costs, incumbent, FOREVER)
    least = least_cost(solver, goal, previous, tolerance, turn)
    assert incumbent.proven
    assert incumbent.cost == pytest.approx(least, rel=1e-9)
    if least < np.inf:
        assert solver.described(
            incumbent.configuration, solver.target(goal, tolerance, turn), previous
        ).within_tolerance


@pytest.mark.parametrize("seed", range(20))
def test_poses_on_their_tolerances(seed, monkeypatch):
    monkeypatch.setattr(cost_to_go, "PREFIXES", (1.0, 30.0)[seed // 2 % 2])  # maps from the first level on, or later
    rng = np.random.default_rng(seed)
    whole = planar_arm(rng)
    arm = held_arm(whole, rng) if seed % 4 == 0 else whole
    weights = rng.choice((1.0, 1.5, 0.1, 0.3), len(arm.actuators)) if seed % 3 else None
    clearance = BodyClearance(arm, obstacle(arm, rng), 0.01) if seed % 5 == 0 else None
    solver = solver_of(arm, weights, clearance)
    for angle in (np.pi / 2, 1e-9, float(rng.uniform(0.01, 3.0)), 3.141592):
        goal, tolerance, turn = pose_on_the_shell(whole, rng, angle)
        check(solver, goal, rng.integers(0, arm.states), tolerance, turn)
