"""Random worlds of a search, and what brute force says of them.

Arms have few configurations. Modules of lattice arms slide and turn by quarters, so that tips are exactly on tolerances
and bodies exactly touch obstacles; all other numbers are random.
"""

from __future__ import annotations

import numpy as np

from hyperbit.controller.manipulator.frames import Frame, planar, spatial, turned
from hyperbit.controller.manipulator.joints import prismatic, revolute
from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module, transforms
from hyperbit.controller.manipulator.vgt import vgt
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles, box, sphere
from hyperbit.controller.search.lists.two_list import ListSizes
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm, spatial_arm

X, Y, Z = np.eye(3)
STEPS, QUARTERS = (0.25, 0.5, 1.0), (0.0, np.pi / 2, np.pi, -np.pi / 2)
ENOUGH = 100  # configurations
Goal = tuple[np.ndarray, float, float]  # position or frame, tolerances of position and angle


def solver_of(
    arm: Manipulator,
    weights: np.ndarray | None = None,
    clearance: BodyClearance | None = None,
    sizes: ListSizes = ListSizes(),
) -> Solver:
    densities = map_densities(arm, arm.length / 20 + 1e-6, 2000)
    return Solver(arm, densities, weights, clearance, list_whole=False, list_sizes=sizes)


def drawn_arm(rng: np.random.Generator, space: bool) -> Manipulator:
    """Returns an arm; some have a single module."""
    kind = rng.integers(5)
    if kind == 0:
        return spatial_arm(3) if space else paper_arm(3)
    module = (lattice_module, any_module)[kind % 2]
    modules = [module(rng, space)]
    while np.prod([len(m.frames) for m in modules]) < ENOUGH and rng.random() < 0.97:
        modules.append(module(rng, space))
    elsewhere = spatial(rng.normal(size=3), rng.normal(size=4)) if space else planar(*rng.normal(size=3))
    return Manipulator(modules, elsewhere if module is any_module and kind == 1 else np.eye(4))


def lattice_module(rng: np.random.Generator, space: bool) -> Module:
    step, axes = float(rng.choice(STEPS)), (X, Y, Z) if space else (X, Y)
    if rng.random() < 0.5:
        return prismatic(axes[rng.integers(len(axes))], (0.0, step), np.eye(4))
    angles = rng.choice(QUARTERS, rng.integers(2, 4), replace=False)
    if space:
        return revolute(axes[rng.integers(3)], angles, spatial(step * axes[rng.integers(3)]))
    return revolute(Z, angles, planar(step, 0.0))


def any_module(rng: np.random.Generator, space: bool) -> Module:
    count = rng.integers(2, 5)
    if space:
        return transforms([spatial(rng.normal(0, 0.3, 3), rng.normal(size=4)) for _ in range(count)], planar=False)
    if rng.random() < 0.3:
        lengths = [tuple(0.2 + rng.uniform((-0.02, 0.02), (0.01, 0.06))) for _ in range(3)]
        return vgt(str(rng.choice(["BC", "AD"])), rng.uniform(0.18, 0.22), *lengths)
    return transforms([planar(*rng.normal(0, 0.3, 2), rng.uniform(-2, 2)) for _ in range(count)], planar=True)


def with_locks(arm: Manipulator, rng: np.random.Generator) -> Manipulator:
    """Returns the arm with some actuators locked, or itself if a module has no such state."""
    held = np.where(rng.random(len(arm.actuators)) < 0.2, arm.actuator_states(rng.integers(0, arm.states)), -1)
    try:
        return lock_actuators(arm, held.astype(np.int8))
    except ValueError:
        return arm


def drawn_weights(arm: Manipulator, rng: np.random.Generator) -> np.ndarray | None:
    """Returns none, weights whose sums tie but for rounding, or any."""
    kind, count = rng.integers(4), len(arm.actuators)
    if kind < 2:
        return None
    return rng.choice((0.1, 0.2, 0.3, 0.6, 1.5), count) if kind == 2 else rng.uniform(0.5, 2.0, count)


def drawn_clearance(arm: Manipulator, rng: np.random.Generator) -> BodyClearance | None:
    """Returns none, an obstacle that some bodies touch exactly, or self-collision."""
    kind = rng.integers(4)
    if kind < 2:
        return None
    radius = float(rng.choice((0.0, 0.01, 0.25)))
    return BodyClearance(arm, obstacle(arm, rng) if kind == 2 else NONE, radius, self_collision=kind == 3)


def obstacle(arm: Manipulator, rng: np.random.Generator) -> Obstacles:
    tip = arm.tip(rng.integers(0, arm.states))[:3, 3]
    if rng.random() < 0.5:
        return sphere("ball", tip + rng.choice((0.0, 0.25, 0.5), 3) * (1, 1, not arm.planar), 0.25)
    return box("block", (tip + 0.5)[: arm.dimension], np.full(arm.dimension, 0.5))


def drawn_goal(arm: Manipulator, rng: np.random.Generator, posed: bool) -> Goal:
    """Returns a goal from which a tip is away by its tolerance in floating point, or by one float more or less."""
    away = float(rng.choice((0.25, 0.5, 1e-9, 10.0 ** rng.uniform(-8, -0.5))))
    if posed:
        angle = float(rng.choice((np.pi / 2, 1e-9, 3.141592, rng.uniform(0.01, 3.0))))
        goal: Frame = arm.tip(rng.integers(0, arm.states)) @ turned(Z if arm.planar else rng.normal(size=3), angle)
        goal[0, 3] += away * rng.integers(0, 2)
        return goal, beside(away, rng), float(np.nextafter(angle, rng.integers(0, 5)))
    tip = arm.tip(rng.integers(0, arm.states))[: arm.dimension, 3]
    position = tip.copy()
    position[rng.integers(arm.dimension)] += away * rng.choice((-1.0, 1.0))
    away = float(np.linalg.norm(position - tip)) if rng.random() < 0.5 else away
    return position, beside(away, rng), np.inf


def beside(number: float, rng: np.random.Generator) -> float:
    """Returns a number, or one float more or less."""
    return float(np.nextafter(number, number + rng.integers(-1, 2)))


def least_cost(solver: Solver, goal: Goal, previous: np.ndarray) -> float:
    """Returns the least cost of the configurations that serve a goal, by brute force; infinite if there is none.

    Only tips within a larger tolerance are compared exactly, because a description takes 0.1 ms.
    """
    arm, target = solver.manipulator, solver.target(*goal)
    every = every_configuration(arm)
    away = np.linalg.norm(arm.tips(every)[:, :3, 3] - target.goal[:3, 3], axis=1)
    near = every[away <= goal[1] + 1e-6]
    serving = [c for c in near if solver.described(c, target, previous).within_tolerance]
    own, weights = arm.actuator_states(previous), solver.weights
    changed = [arm.per_module((arm.actuator_states(c) != own).astype(float)) for c in serving]
    return min((float((weights * each).sum()) for each in changed), default=np.inf)
