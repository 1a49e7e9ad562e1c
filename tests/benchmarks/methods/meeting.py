"""Plain meet in the middle: both halves listed to so many switches from the previous configuration, tips hashed.

After Horowitz and Sahni 1974, "Computing partitions with applications to the knapsack problem": two lists of
half the problem, matched, in place of one of the whole. Rigid motions keep distances, so the tip's error is the
distance of the goal seen from the lower half's top and the upper half's tip: both halves are lists of points, the goal
carried up through the lower modules and the tip carried down through the upper ones. Listed anew for each goal.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.workspace.densities import Densities
from tests.benchmarks.methods import paper_pop
from tests.benchmarks.methods.cells import Cells, cheapest
from tests.benchmarks.methods.halves import Half
from tests.benchmarks.methods.planar import Array, Planar, planar

SWITCHES = 5
NONE = 1 << 30


@dataclass(frozen=True, eq=False)
class Problem:
    arm: Planar
    lower: Half
    upper: Half
    cells: Cells
    switches: int
    fallback: paper_pop.Problem | None


def prepare(manipulator: Manipulator, densities: Densities | None, switches: int = SWITCHES) -> Problem:
    """Allocates; where nothing is within the tolerance, the densities have a configuration near it all the same."""
    arm = planar(manipulator)
    middle, count = len(arm.states) // 2, len(arm.states)
    lower = Half(arm, arm.down, np.arange(middle), switches)
    upper = Half(arm, arm.up, np.arange(middle, count)[::-1], switches)
    fallback = None if densities is None else paper_pop.prepare(manipulator, densities)
    return Problem(arm, lower, upper, Cells(upper), switches, fallback)


def solve(problem: Problem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    found = meet(problem, goal, previous, tolerance, NONE)
    return paper_pop.solve(problem.fallback, goal, previous, tolerance) if found is None else found[0]


def meet(
    problem: Problem, goal: Array, previous: Configuration, tolerance: float, below: int
) -> tuple[Configuration, int] | None:
    """Returns the configuration of fewest switches, if fewer than `below`, and their number."""
    p, costs, c = problem, problem.arm.costs(previous), problem.cells
    p.lower.list((goal[0], goal[1]), costs, p.switches)
    p.upper.list((0.0, 0.0), costs, p.switches)
    c.fill(tolerance)
    points, prices, order = p.lower.points, p.lower.prices, p.lower.order
    table = (p.upper.points, p.upper.prices, c.starts, c.rows, c.low, c.cell, c.width, c.height)
    i, j, switches = match(points, prices, order, p.lower.count, *table, tolerance, below)
    if i < 0:
        return None
    configuration = np.empty(len(previous), dtype=np.int64)
    p.lower.write(p.lower.codes[i], configuration)
    p.upper.write(p.upper.codes[j], configuration)
    return configuration, switches


@njit(
    "UniTuple(i8, 3)(f8[:,::1], i1[::1], i4[::1], i8, f8[:,::1], i1[::1], i4[::1], i4[::1], f8[::1], f8, i8, i8, f8,"
    " i8)",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def match(
    asking: Array,
    asking_prices: NDArray[np.int8],
    order: NDArray[np.int32],
    count: int,
    points: Array,
    prices: NDArray[np.int8],
    starts: NDArray[np.int32],
    rows: NDArray[np.int32],
    low: Array,
    cell: float,
    width: int,
    height: int,
    tolerance: float,
    best: int,
) -> tuple[int, int, int]:
    """Returns rows and switches of the cheapest pair within the tolerance, if below `best`; else (-1, -1, best)."""
    first, second = -1, -1
    for k in range(count):
        n = order[k]
        price = np.int64(asking_prices[n])
        if price >= best:
            break
        x, y = asking[n, 0], asking[n, 1]
        row, best = cheapest(x, y, price, points, prices, starts, rows, low, cell, width, height, tolerance, best)
        if row >= 0:
            first, second = n, row
    return first, second, best
