"""Solvers with their tables, random goals, and goals that are solved one after another."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities

WARM = 3  # goals before those that count

Solve = Callable[[NDArray[np.float64], Configuration], Solution]


def ready_solver(arm: Arm) -> Solver:
    manipulator = arm.manipulator
    solver = Solver(manipulator, map_densities(manipulator, arm.pixel, arm.level_pixels), weights_of(arm))
    solver.prepare()
    return solver


def home(manipulator: Manipulator) -> Configuration:
    return np.zeros(len(manipulator.states), dtype=np.int64)


def random_tips(manipulator: Manipulator, count: int, seed: int = 1) -> NDArray[np.float64]:
    """Returns the tips of uniformly random configurations, shape (count, 4, 4)."""
    configurations = np.random.default_rng(seed).integers(0, manipulator.states, (count, len(manipulator.states)))
    return manipulator.tips(configurations)


def solved_in_sequence(
    solve: Solve, goals: NDArray[np.float64], start: Configuration
) -> tuple[list[Configuration], list[Solution]]:
    """Solves goals, each from the configuration reached for the goal before.

    Args:
        goals: the first `WARM` are also solved before, without being counted.

    Returns:
        The previous configuration and the solution of each goal.
    """
    for goal in goals[:WARM]:
        solve(goal, start)
    before, found = [start], list[Solution]()
    for goal in goals:
        found.append(solve(goal, before[-1]))
        before.append(found[-1].configuration)
    return before[:-1], found
