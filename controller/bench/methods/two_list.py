"""Plain meet in the middle with two lists: both halves up to a number of switches from the previous configuration.

After Horowitz and Sahni 1974, "Computing partitions with applications to the knapsack problem": two matched lists of
half the problem instead of one list of the whole. Rigid motions preserve distances. So the tip's error is the distance
between the goal, transformed into the frame of the middle by the lower modules, and the tip, transformed into that
frame by the upper modules. Both lists are computed for each goal. The upper one is sorted into square cells.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int8, int64, types
from numpy.typing import NDArray

from hyperbit.controller.bench.methods import paper
from hyperbit.controller.bench.methods.planar import Array, Index, Planar, moved, planar
from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, S1, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.workspace.densities import Densities

SWITCHES = 5
NONE = 1 << 30
CELLS = 1 << 20

Small = NDArray[np.int32]
Prices = NDArray[np.int8]


class CellTable(NamedTuple):
    """Rows of a list, sorted into square cells by their points, the cheapest first in each cell."""

    points: Array  # of the list, shape (n, 2)
    prices: Prices  # of the list, shape (n,)
    starts: Small  # first of `rows` of each cell, shape (cells + 1,)
    rows: Small  # of the list, cell by cell, shape (n,)
    low: Array  # lower corner of the first cell, shape (2,)
    cell: float  # side of a cell; at least two tolerances
    width: int  # number of cells along x
    height: int  # number of cells along y


CELL_TABLE = named(CellTable, F2, int8[::1], S1, S1, F1, float64, int64, int64)
FOUND: Any = types.UniTuple(int64, 2)  # type: ignore[no-untyped-call]
FOUND_PAIR: Any = types.UniTuple(int64, 3)  # type: ignore[no-untyped-call]


class HalfList:
    """The list of all configurations of half an arm within a number of switches, each with the image of a point.

    `motions` (B, K, 4) are those of all modules. `modules` of the half are in the order in which they move the point.
    """

    def __init__(self, arm: Planar, motions: Array, modules: Index, switches: int) -> None:
        self.modules = modules
        self.motions, self.states = np.ascontiguousarray(motions[modules]), arm.states[modules]
        rows = most_rows(arm.differing[modules], self.states, switches)
        self.points, self.prices = np.empty((rows, 2)), np.empty(rows, dtype=np.int8)
        self.codes, self.order = np.empty(rows, dtype=np.int64), np.empty(rows, dtype=np.int32)
        self.count = 0

    def list(self, start: tuple[float, float], costs: Index, switches: int) -> None:
        """Lists all configurations of the half within a number of switches; `order`: the cheapest first."""
        own = np.ascontiguousarray(costs[self.modules])
        self.points[0] = start
        self.count = grow(self.motions, own, self.states, switches, self.points, self.prices, self.codes)
        by_price(self.prices, self.count, switches, self.order)

    def write(self, code: int, configuration: Configuration) -> None:
        """Writes the states of a row's code into a configuration (B,)."""
        for module, states in zip(self.modules[::-1], self.states[::-1], strict=True):
            code, configuration[module] = divmod(int(code), int(states))


@dataclass(frozen=True, eq=False)
class TwoLists:
    """The tables of an arm: lists, memory for the cells, and POP for goals that no pair of the lists reaches."""

    arm: Planar
    lower: HalfList
    upper: HalfList
    starts: Small
    rows: Small
    switches: int
    fallback: paper.PaperTables | None


def prepare(manipulator: Manipulator, densities: Densities | None, switches: int = SWITCHES) -> TwoLists:
    arm = planar(manipulator)
    middle, count = len(arm.states) // 2, len(arm.states)
    lower = HalfList(arm, arm.down, np.arange(middle), switches)
    upper = HalfList(arm, arm.up, np.arange(middle, count)[::-1], switches)
    starts, rows = np.empty(CELLS + 1, dtype=np.int32), np.empty(len(upper.points), dtype=np.int32)
    fallback = None if densities is None else paper.prepare(manipulator, densities)
    return TwoLists(arm, lower, upper, starts, rows, switches, fallback)


def solve(tables: TwoLists, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    if (found := meet(tables, goal, previous, tolerance, NONE)) is not None:
        return found[0]
    return previous if tables.fallback is None else paper.solve_pop(tables.fallback, goal, previous, tolerance)


def meet(
    tables: TwoLists, goal: Array, previous: Configuration, tolerance: float, below: int
) -> tuple[Configuration, int] | None:
    """Returns the configuration of fewest switches and their number; None if there is none below `below`."""
    lower, upper, costs = tables.lower, tables.upper, tables.arm.costs(previous)
    lower.list((goal[0], goal[1]), costs, tables.switches)
    upper.list((0.0, 0.0), costs, tables.switches)
    cells = cells_of(upper, tables.starts, tables.rows, tolerance)
    i, j, switches = match(lower.points, lower.prices, lower.order, lower.count, cells, tolerance, below)
    if i < 0:
        return None
    configuration = np.empty(len(previous), dtype=np.int64)
    lower.write(lower.codes[i], configuration)
    upper.write(upper.codes[j], configuration)
    return configuration, switches


def cells_of(half: HalfList, starts: Small, rows: Small, tolerance: float) -> CellTable:
    """Sorts the present rows of a list into cells."""
    low, high = np.empty(2), np.empty(2)
    box(half.points, half.count, low, high)
    size = high - low
    cell = max(2 * tolerance, float(np.sqrt(2 * np.prod(size) / CELLS)), float(4 * size.max() / CELLS))
    width, height = (int(extent / cell) + 1 for extent in size)
    table = CellTable(half.points, half.prices, starts, rows, low, cell, width, height)
    sort(half.order, half.count, table)
    return table


def most_rows(differing: Index, states: Index, switches: int) -> int:
    """Returns an upper bound on the number of configurations within a number of switches of any configuration."""
    if np.prod(states.astype(float)) > 2**62:
        raise ValueError("half of the arm has more configurations than 64 bits can number")
    total = np.eye(1, switches + 1, dtype=np.int64)[0]
    for module, k in zip(differing, states, strict=True):
        counts = np.max([np.bincount(row[:k], minlength=switches + 1) for row in module[:k]], axis=0)
        total = np.convolve(total, counts)[: switches + 1]
    return int(total.sum())


@kernel("i8(f8[:,:,::1], i8[:,::1], i8[::1], i8, f8[:,::1], i1[::1], i8[::1])", error_model="numpy")
def grow(motions: Array, costs: Index, states: Index, most: int, points: Array, prices: Prices, codes: Index) -> int:
    """Expands row 0, a point, into rows for all configurations with at most `most` switches; returns their number."""
    prices[0], codes[0], count = 0, 0, 1
    for i in range(len(states)):
        end = count
        for n in range(end):
            x, y, price, code = points[n, 0], points[n, 1], prices[n], codes[n] * states[i]
            for j in range(states[i]):
                cost = price + costs[i, j]
                if cost <= most:
                    row = n  # the previous state reuses the row
                    if costs[i, j] > 0:
                        row = count
                        count += 1
                    points[row, 0], points[row, 1] = moved(motions[i, j], x, y)
                    prices[row], codes[row] = cost, code + j
    return count


@kernel("void(i1[::1], i8, i8, i4[::1])")
def by_price(prices: Prices, count: int, most: int, order: Small) -> None:
    """Writes the order of the rows by price, cheapest first (counting sort)."""
    starts = np.zeros(most + 2, dtype=np.int64)
    for n in range(count):
        starts[prices[n] + 1] += 1
    for price in range(most):
        starts[price + 1] += starts[price]
    for n in range(count):
        order[starts[prices[n]]] = n
        starts[prices[n]] += 1


@kernel("void(f8[:,::1], i8, f8[::1], f8[::1])")
def box(points: Array, count: int, low: Array, high: Array) -> None:
    low[:], high[:] = np.inf, -np.inf
    for n in range(count):
        for a in range(2):
            low[a], high[a] = min(low[a], points[n, a]), max(high[a], points[n, a])


@kernel(types.void(S1, int64, CELL_TABLE), error_model="numpy")
def sort(order: Small, count: int, table: CellTable) -> None:
    """Writes `starts` and `rows` of a table: `count` rows of the list, in `order`, the cheapest first in each cell."""
    points, _, starts, rows, low, cell, width, height = table
    starts[: width * height + 1] = 0
    for n in range(count):
        c = int((points[n, 1] - low[1]) / cell) * width + int((points[n, 0] - low[0]) / cell)
        starts[c] += 1
    for c in range(width * height):
        starts[c + 1] += starts[c]
    for k in range(count - 1, -1, -1):
        n = order[k]
        c = int((points[n, 1] - low[1]) / cell) * width + int((points[n, 0] - low[0]) / cell)
        starts[c] -= 1
        rows[starts[c]] = n


@kernel(
    [FOUND(float64, float64, int64, CELL_TABLE, float64, int64)],
    error_model="numpy",
    inline="always",
)
def cheapest(x: float, y: float, price: int, table: CellTable, tolerance: float, best: int) -> tuple[int, int]:
    """Returns the cheapest row near (x, y) and its price plus `price`, if below `best`; otherwise (-1, best)."""
    # Cells are at least two tolerances wide, so a disc of the tolerance touches at most four cells.
    points, prices, starts, rows, low, cell, width, height = table
    found = -1
    fx, fy = (x - low[0]) / cell - 0.5, (y - low[1]) / cell - 0.5
    if not (-1 <= fx < width and -1 <= fy < height):
        return found, best
    cx, cy = int(np.floor(fx)), int(np.floor(fy))
    for iy in range(max(cy, 0), min(cy + 2, height)):
        for ix in range(max(cx, 0), min(cx + 2, width)):
            c = iy * width + ix
            for k in range(starts[c], starts[c + 1]):
                row = rows[k]
                if price + prices[row] >= best:
                    break
                dx, dy = points[row, 0] - x, points[row, 1] - y
                if dx * dx + dy * dy <= tolerance * tolerance:
                    found, best = row, price + prices[row]
    return found, best


@kernel([FOUND_PAIR(F2, int8[::1], S1, int64, CELL_TABLE, float64, int64)], error_model="numpy")
def match(
    points: Array, prices: Prices, order: Small, count: int, table: CellTable, tolerance: float, best: int
) -> tuple[int, int, int]:
    """Returns rows and switches of the cheapest pair within the tolerance, if below `best`; else (-1, -1, best)."""
    first, second = -1, -1
    for k in range(count):
        n = order[k]
        price = int(prices[n])
        if price >= best:
            break
        x, y = points[n, 0], points[n, 1]
        row, best = cheapest(x, y, price, table, tolerance, best)
        if row >= 0:
            first, second = n, row
    return first, second, best
