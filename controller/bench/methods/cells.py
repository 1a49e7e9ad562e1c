"""The rows of a half, sorted into cells by where their points are, to be asked for what is near."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.bench.methods.halves import Half
from controller.bench.methods.matching import Table
from controller.bench.methods.planar import Array

CELLS = 1 << 20


class Cells:
    """Rows of a half sorted into cells by where their points are, the cheapest first in each."""

    def __init__(self, half: Half) -> None:
        self._half = half
        self.starts, self.rows = np.empty(CELLS + 1, dtype=np.int32), np.empty(len(half.points), dtype=np.int32)
        self.low, self.cell, self.width, self.height = np.empty(2), 0.0, 0, 0

    @property
    def table(self) -> Table:
        """What the kernels that ask it take."""
        half = self._half
        return half.points, half.prices, self.starts, self.rows, self.low, self.cell, self.width, self.height

    def fill(self, tolerance: float) -> None:
        """Sorts the rows that the half has now."""
        half, high = self._half, np.empty(2)
        box(half.points, half.count, self.low, high)
        size = high - self.low
        self.cell = max(2 * tolerance, float(np.sqrt(2 * np.prod(size) / CELLS)), float(4 * size.max() / CELLS))
        self.width, self.height = (int(extent / self.cell) + 1 for extent in size)
        sort(half.points, half.order, half.count, self.low, self.cell, self.width, self.height, self.starts, self.rows)


@njit("void(f8[:,::1], i8, f8[::1], f8[::1])", cache=True, nogil=True)
def box(points: Array, count: int, low: Array, high: Array) -> None:
    """Writes the least and the greatest corner of the points."""
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
