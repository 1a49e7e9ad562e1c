"""Sets of goals, each with its own seed, so that a set does not depend on the other sets."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities
from tests.benchmarks.solving import home, random_tips

Goals = NDArray[np.float64]

# Configurations within a goal's tolerance: at most so many at the workspace's edge, at least so many where it is dense.
FEW, MANY = 10.0, 1_000.0


def random(manipulator: Manipulator, densities: Densities, tolerance: float, number: int) -> Goals:
    """Tips of uniformly random configurations."""
    return np.ascontiguousarray(random_tips(manipulator, number)[:, :2, 3])


def curve(manipulator: Manipulator, densities: Densities, tolerance: float, number: int) -> Goals:
    turn = np.linspace(0, 2 * np.pi, 200, endpoint=False)[:number]
    tips = random(manipulator, densities, tolerance, 1_000)
    good = expected(densities, tolerance) >= MANY
    half = 2 * tips.std(axis=0)
    while True:
        waypoints = tips.mean(axis=0) + half * np.column_stack((np.sin(turn), np.sin(2 * turn)))
        x, y = np.round((waypoints - densities.references[0, :2]) / densities.pixels[0]).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < good.shape[1]) & (y < good.shape[0])
        if inside.all() and good[y, x].all():
            return waypoints
        half *= 0.9


def boundary(manipulator: Manipulator, densities: Densities, tolerance: float, number: int) -> Goals:
    """Tips at the edge of the workspace, in pixels with few points."""
    few = expected(densities, tolerance)
    centres = pixels(densities, (few > 0) & (few <= FEW))
    drawn = np.random.default_rng(2).choice(centres, number)
    solver, start = Solver(manipulator, densities), home(manipulator)
    return np.array([solver.solve(solver.target(goal, tolerance), start, "pop").tip[:2, 3] for goal in drawn])


def arbitrary(manipulator: Manipulator, densities: Densities, tolerance: float, number: int) -> Goals:
    """Uniform points in the dense part of the workspace, reachable or not."""
    rng = np.random.default_rng(3)
    centres = pixels(densities, expected(densities, tolerance) >= MANY)
    return rng.choice(centres, number) + densities.pixels[0] * rng.uniform(-0.5, 0.5, (number, 2))


def expected(densities: Densities, tolerance: float) -> Goals:
    """Returns how many configurations are expected within the tolerance, for each pixel of W_0 (y, x)."""
    values = densities.level(0)[0]
    share = np.pi * tolerance**2 / densities.pixels[0] ** 2
    return np.where(values >= 0, np.exp(values.astype(float)) * share, 0.0)


def pixels(densities: Densities, chosen: NDArray[np.bool_]) -> Goals:
    """Returns the centres (n, 2) of the chosen pixels of W_0."""
    y, x = np.nonzero(chosen)
    return densities.references[0, :2] + densities.pixels[0] * np.column_stack((x, y))


Draw = Callable[[Manipulator, Densities, float, int], Goals]
SETS: dict[str, tuple[Draw, int]] = {
    "random": (random, 1_000),
    "curve": (curve, 200),
    "boundary": (boundary, 100),
    "arbitrary": (arbitrary, 200),
}
