"""A grid of cells over the points of a list, for queries of near points."""

import numpy as np
from numba import int64, njit, types
from numpy.typing import NDArray

from hyperbit.controller.bench.methods.half_list import HalfList
from hyperbit.controller.bench.methods.matching import CELL_TABLE, CellTable
from hyperbit.controller.bench.methods.planar import Array
from hyperbit.controller.manipulator.kernel_types import S1

CELLS = 1 << 20


class SquareCells:
    """Rows of a list sorted into square cells by their points, cheapest first in each cell."""

    def __init__(self, half: HalfList) -> None:
        self._half = half
        self.starts, self.rows = np.empty(CELLS + 1, dtype=np.int32), np.empty(len(half.points), dtype=np.int32)
        self.low, self.cell, self.width, self.height = np.empty(2), 0.0, 0, 0

    @property
    def table(self) -> CellTable:
        """The cells for kernels."""
        half = self._half
        cells = self.low, self.cell, self.width, self.height
        return CellTable(half.points, half.prices, self.starts, self.rows, *cells)

    def fill(self, tolerance: float) -> None:
        """Sorts the present rows of the list into cells."""
        half, high = self._half, np.empty(2)
        box(half.points, half.count, self.low, high)
        size = high - self.low
        self.cell = max(2 * tolerance, float(np.sqrt(2 * np.prod(size) / CELLS)), float(4 * size.max() / CELLS))
        self.width, self.height = (int(extent / self.cell) + 1 for extent in size)
        sort(half.order, half.count, self.table)


@njit("void(f8[:,::1], i8, f8[::1], f8[::1])", cache=True, nogil=True)
def box(points: Array, count: int, low: Array, high: Array) -> None:
    """Writes the lower and the upper corner of the points' bounding box."""
    low[:], high[:] = np.inf, -np.inf
    for n in range(count):
        for a in range(2):
            low[a], high[a] = min(low[a], points[n, a]), max(high[a], points[n, a])


@njit(types.void(S1, int64, CELL_TABLE), cache=True, nogil=True, error_model="numpy")
def sort(order: NDArray[np.int32], count: int, table: CellTable) -> None:
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
