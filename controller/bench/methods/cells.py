"""A grid of cells over the points of a list, for queries of near points."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.bench.methods.half_list import HalfList
from controller.bench.methods.matching import Table
from controller.bench.methods.planar import Array

CELLS = 1 << 20


class Cells:
    """Rows of a list sorted into square cells by their points, cheapest first in each cell."""

    def __init__(self, half: HalfList) -> None:
        self._half = half
        self.starts, self.rows = np.empty(CELLS + 1, dtype=np.int32), np.empty(len(half.points), dtype=np.int32)
        self.low, self.cell, self.width, self.height = np.empty(2), 0.0, 0, 0

    @property
    def table(self) -> Table:
        """The arrays that the kernels take."""
        half = self._half
        return half.points, half.prices, self.starts, self.rows, self.low, self.cell, self.width, self.height

    def fill(self, tolerance: float) -> None:
        """Sorts the present rows of the list into cells."""
        half, high = self._half, np.empty(2)
        box(half.points, half.count, self.low, high)
        size = high - self.low
        self.cell = max(2 * tolerance, float(np.sqrt(2 * np.prod(size) / CELLS)), float(4 * size.max() / CELLS))
        self.width, self.height = (int(extent / self.cell) + 1 for extent in size)
        sort(half.points, half.order, half.count, self.low, self.cell, self.width, self.height, self.starts, self.rows)


@njit("void(f8[:,::1], i8, f8[::1], f8[::1])", cache=True, nogil=True)
def box(points: Array, count: int, low: Array, high: Array) -> None:
    """Writes the lower and the upper corner of the points' bounding box."""
    low[:], high[:] = np.inf, -np.inf
    for n in range(count):
        for a in range(2):
            low[a], high[a] = min(low[a], points[n, a]), max(high[a], points[n, a])


@njit(
    "void(f8[:,::1], i4[::1], i8, f8[::1], f8, i8, i8, i4[::1], i4[::1])", cache=True, nogil=True, error_model="numpy"
)
def sort(
    points: Array,
    order: NDArray[np.int32],
    count: int,
    low: Array,
    cell: float,
    width: int,
    height: int,
    starts: NDArray[np.int32],
    rows: NDArray[np.int32],
) -> None:
    """Sorts rows into cells, cheapest first in each: cell c has `rows[starts[c] : starts[c + 1]]`."""
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
