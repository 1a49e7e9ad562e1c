"""The cheapest sequence of an arm that is listed whole: dynamic programming over all its configurations."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.points import TrajectoryPoint
from hyperbit.controller.search.search_time import TRIED
from hyperbit.controller.search.solver import Solver

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


def cheapest_of_all(
    solver: Solver, points: Sequence[TrajectoryPoint], start: Configuration, seconds: float, stop: Callable[[], bool]
) -> tuple[Integers, float] | None:
    """Returns the cheapest sequence (n, B) from a configuration (B,), and its cost; empty and infinite if none serves.

    Returns None if the arm has too many configurations for a time [s], or if `stop` returns true.
    """
    every, until = solver.enumeration, solver.clock.now() + seconds
    if every is None or TRIED * every.changes * len(points) > seconds:
        return None
    rows, layers = every.configurations, list[tuple[Integers, Array]]()
    costs = np.full(len(rows), np.inf)  # of the cheapest sequence that ends in each configuration
    costs[every.index(start)] = 0.0
    clear = np.full(len(rows), 1 if solver.clearance is None else -1)  # -1: not known yet
    for point in points:
        if solver.clock.now() > until or stop():
            return None
        every.spread(solver.chain.costs, costs)
        fixed = point.configuration
        served = every.met(point.target) if fixed is None else np.arange(len(rows)) == every.index(fixed)
        new = np.flatnonzero(served & (clear < 0))
        if solver.clearance is not None and len(new):
            clear[new] = ~solver.clearance.blocked(rows[new])
        costs[~served | (clear != 1)] = np.inf
        layers.append(((own := np.flatnonzero(costs < np.inf)), costs[own]))
        if not len(own):
            return np.empty((0, rows.shape[1]), np.int64), np.inf
    sequence = [rows[np.argmin(costs)]]
    for own, before in reversed(layers[:-1]):
        sequence.append(rows[own[np.argmin(before + solver.cost(rows[own], sequence[-1]))]])
    return np.array(sequence[::-1]), float(costs.min())
