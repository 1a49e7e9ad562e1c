"""Certificates against brute force, with tips exactly on the tolerance or one float beside it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hyperbit.controller.manipulator.frames import Frame, planar, spatial, turned
from hyperbit.controller.manipulator.joints import prismatic, revolute
from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module, transforms
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles, box, sphere
from hyperbit.controller.search.lists.two_list import ListSizes
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm, spatial_arm

QUARTERS = (0.0, np.pi / 2, np.pi, -np.pi / 2)
X, Y, Z = np.eye(3)


def solver_of(
    arm: Manipulator,
    weights: np.ndarray | None = None,
    clearance: BodyClearance | None = None,
    sizes: ListSizes = ListSizes(),
) -> Solver:
    densities = map_densities(arm, arm.length / 20 + 1e-6, 2000)
    return Solver(arm, densities, weights, clearance, list_whole=False, list_sizes=sizes)


def least_cost(solver: Solver, goal: np.ndarray, previous: np.ndarray, tolerance: float, turn: float) -> float:
    """Returns the least cost of the configurations within the tolerances, by brute force; infinite if there is none.

    Only tips within a larger tolerance are compared exactly, because a description takes 0.1 ms.
    """
    every, target = every_configuration(solver.manipulator), solver.target(goal, tolerance, turn)
    away = np.linalg.norm(solver.manipulator.tips(every)[:, :3, 3] - target.goal[:3, 3], axis=1)
    each = [solver.described(c, target, previous) for c in every[away <= tolerance + 1e-6]]
    return min((s.cost for s in each if s.within_tolerance), default=np.inf)


def check(
    solver: Solver, goal: np.ndarray, previous: np.ndarray, tolerance: float, turn: float = np.inf, whole: bool = True
) -> Solution:
    """Solves a goal and compares the certificate with brute force over all configurations.

    With `whole` the lists hold every configuration, so that the answer is proven.
    """
    found = solver.solve(solver.target(goal, tolerance, turn), previous, timeout=60.0)
    least = least_cost(solver, goal, previous, tolerance, turn)
    if found.certificate == "optimal":
        assert found.within_tolerance
        assert found.cost == pytest.approx(least, rel=1e-9)
    elif found.certificate == "unreachable":
        assert least == np.inf
        assert not found.within_tolerance
    else:
        assert not whole
        assert found.bound <= least * (1 + 1e-9)
    assert found.bound <= found.cost or not found.within_tolerance
    return found


def test_a_tip_exactly_on_the_tolerance_counts_for_the_certificate_as_for_the_answer():
    arm = Manipulator([prismatic(X, (0.25, 0.5), np.eye(4))] * 2)
    found = check(solver_of(arm), np.array((0.5, 0.0)), np.array((1, 1)), 0.25)
    assert (found.switches, found.error, found.certificate) == (1, 0.25, "optimal")


# Modules of lattice arms: planar and spatial, sliding and turning by quarters.
def planar_lattice(rng: np.random.Generator) -> Module:
    step = float(rng.choice((0.25, 0.5, 1.0)))
    if rng.random() < 0.5:
        return prismatic((X, Y)[rng.integers(2)], (0.0, step), np.eye(4))
    return revolute(Z, rng.choice(QUARTERS, rng.integers(2, 5), replace=False), planar(step, 0.0))


def spatial_lattice(rng: np.random.Generator) -> Module:
    step, axes = float(rng.choice((0.25, 0.5, 1.0))), (X, Y, Z)
    if rng.random() < 0.5:
        return prismatic(axes[rng.integers(3)], (0.0, step), np.eye(4))
    angles = rng.choice(QUARTERS, rng.integers(2, 4), replace=False)
    return revolute(axes[rng.integers(3)], angles, spatial(step * axes[rng.integers(3)]))


def lattice_arm(rng: np.random.Generator) -> Manipulator:
    kind = (planar_lattice, spatial_lattice)[rng.integers(2)]
    modules: list[Module] = []
    while not modules or np.prod([len(m.frames) for m in modules]) < 100:
        modules.append(kind(rng))
    return Manipulator(modules)


def any_module(rng: np.random.Generator, space: bool) -> Module:
    count = rng.integers(2, 5)
    if space:
        return transforms([spatial(rng.normal(0, 0.3, 3), rng.normal(size=4)) for _ in range(count)], planar=False)
    return transforms([planar(*rng.normal(0, 0.3, 2), rng.uniform(-2, 2)) for _ in range(count)], planar=True)


def any_arm(rng: np.random.Generator) -> Manipulator:
    kind = rng.integers(4)
    if kind == 0:
        return paper_arm(3)
    if kind == 1:
        return spatial_arm(3)
    modules: list[Module] = []
    while not modules or np.prod([len(m.frames) for m in modules]) < 100:
        modules.append(any_module(rng, kind == 2 or (kind == 3 and rng.random() < 0.3)))
    return Manipulator(modules)


def on_the_shell(arm: Manipulator, rng: np.random.Generator, base: float) -> tuple[np.ndarray, float]:
    """A position, and its distance from the tip of a configuration in floating point, or one float beside it."""
    tip = arm.tip(rng.integers(0, arm.states))[: arm.dimension, 3]
    goal = tip.copy()
    goal[rng.integers(arm.dimension)] += base * rng.choice((-1.0, 1.0))
    away = np.linalg.norm(goal - tip) if rng.random() < 0.5 else base
    return goal, float(np.nextafter(away, away + rng.integers(-1, 2)))


@pytest.mark.parametrize("seed", range(60))
def test_lattice_arms_on_the_shell_and_one_float_beside_it(seed):
    rng = np.random.default_rng(seed)
    arm = lattice_arm(rng)
    solver = solver_of(arm)
    for _ in range(4):
        goal, tolerance = on_the_shell(arm, rng, float(rng.choice((0.25, 0.5))))
        check(solver, goal, rng.integers(0, arm.states), tolerance)


@pytest.mark.parametrize("seed", range(40))
def test_random_arms_on_the_shell(seed):
    rng = np.random.default_rng(seed)
    arm = any_arm(rng)
    solver = solver_of(arm)
    for _ in range(3):
        goal, tolerance = on_the_shell(arm, rng, float(10.0 ** rng.uniform(-8, -0.5)))
        check(solver, goal, rng.integers(0, arm.states), tolerance)


@pytest.mark.parametrize("seed", range(20))
def test_weights_whose_sums_tie_but_for_rounding(seed):
    rng = np.random.default_rng(seed)
    arm = (lattice_arm, any_arm)[seed % 2](rng)
    solver = solver_of(arm, rng.choice((0.1, 0.2, 0.3, 0.6, 0.7), len(arm.actuators)))
    for _ in range(3):
        goal, tolerance = on_the_shell(arm, rng, 0.25)
        check(solver, goal, rng.integers(0, arm.states), tolerance)


@pytest.mark.parametrize("seed", range(20))
def test_locked_actuators(seed):
    rng = np.random.default_rng(seed)
    whole = (lattice_arm, any_arm)[seed % 2](rng)
    held = np.where(rng.random(len(whole.actuators)) < 0.2, whole.actuator_states(rng.integers(0, whole.states)), -1)
    try:
        arm = lock_actuators(whole, held.astype(np.int8))
    except ValueError:
        pytest.skip("a module has no such state")
    solver = solver_of(arm)
    for _ in range(3):
        goal, tolerance = on_the_shell(whole, rng, 0.25)
        check(solver, goal, rng.integers(0, arm.states), tolerance)


# Short lists, so that proofs need all stages: layers, look-ups, and a second band.
SIZES = [
    ListSizes(near, wide, 2 * wide, quarter, layer, at_once=3)
    for near, wide, quarter, layer in ((2, 6, 3, 1), (6, 40, 1000, 1), (12, 30, 8, 100))
]


@pytest.mark.parametrize("seed", range(15))
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_what_short_lists_leave_out_is_streamed_or_not_claimed(seed: int, sizes: ListSizes) -> None:
    rng = np.random.default_rng(seed)
    arm = (lattice_arm, any_arm)[seed % 2](rng)
    weights = rng.choice((1.0, 1.5, 0.1, 0.3), len(arm.actuators)) if seed % 3 else None
    clearance = BodyClearance(arm, obstacle(arm, rng), 0.01) if seed % 5 == 0 else None
    solver = solver_of(arm, weights, clearance, sizes)
    for turn in (np.inf, np.inf, np.pi / 2, 1e-9):
        goal, tolerance = on_the_shell(arm, rng, 0.25)
        asked = goal if turn == np.inf else arm.tip(rng.integers(0, arm.states))
        check(solver, asked, rng.integers(0, arm.states), tolerance, turn, whole=False)


def obstacle(arm: Manipulator, rng: np.random.Generator) -> Obstacles:
    tip = arm.tip(rng.integers(0, arm.states))[:3, 3]
    if rng.random() < 0.5:
        return sphere("ball", tip + rng.choice((0.0, 0.25, 0.5), 3) * (1, 1, not arm.planar), 0.25)
    size = np.full(arm.dimension, 0.5)
    return box("block", (tip + 0.5)[: arm.dimension], size)


@pytest.mark.parametrize("seed", range(30))
def test_obstacles_touched_exactly(seed):
    """Some bodies are exactly one radius away from an obstacle."""
    rng = np.random.default_rng(seed)
    arm = (lattice_arm, any_arm)[seed % 2](rng)
    crossing = bool(rng.random() < 0.3)
    obstacles = NONE if crossing else obstacle(arm, rng)
    solver = solver_of(
        arm, clearance=BodyClearance(arm, obstacles, float(rng.choice((0.0, 0.25))), self_collision=crossing)
    )
    for _ in range(3):
        goal, tolerance = on_the_shell(arm, rng, 0.25)
        check(solver, goal, rng.integers(0, arm.states), tolerance)


def pose_on_the_shell(arm: Manipulator, rng: np.random.Generator, angle: float) -> tuple[Frame, float, float]:
    goal = arm.tip(rng.integers(0, arm.states)) @ turned(Z if arm.planar else rng.normal(size=3), angle)
    away = float(rng.choice((0.25, 1e-9)))
    goal[0, 3] += away * rng.integers(0, 2)
    return goal, float(np.nextafter(away, away + rng.integers(-1, 2))), float(np.nextafter(angle, rng.integers(0, 5)))


@pytest.mark.parametrize("seed", range(40))
def test_orientations_on_their_tolerance(seed):
    rng = np.random.default_rng(seed)
    arm = (lattice_arm, any_arm)[seed % 2](rng)
    solver = solver_of(arm)
    for angle in (np.pi / 2, 1e-9, float(rng.uniform(0.01, 3.0)), 3.141592):
        goal, tolerance, turn = pose_on_the_shell(arm, rng, angle)
        check(solver, goal, rng.integers(0, arm.states), tolerance, turn)


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
