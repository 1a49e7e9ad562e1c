"""Matches the points of one list with near points of another list, which is sorted into cells."""

from typing import Any, NamedTuple

import numpy as np
from numba import float64, int8, int64, njit, types
from numpy.typing import NDArray

from hyperbit.controller.bench.methods.planar import Array
from hyperbit.controller.manipulator.kernel_types import F1, F2, S1, named


class CellTable(NamedTuple):
    """Rows of a list, sorted into square cells; see SquareCells.

    Attributes:
        points: points of the list, shape (n, 2).
        prices: prices of the list, shape (n,).
        starts: first of `rows` of each cell, shape (cells + 1,).
        rows: rows of the list, cell by cell, shape (n,).
        low: lower corner of the first cell, shape (2,).
        cell: side of a cell.
        width: number of cells along x.
        height: number of cells along y.
    """

    points: Array
    prices: NDArray[np.int8]
    starts: NDArray[np.int32]
    rows: NDArray[np.int32]
    low: Array
    cell: float
    width: int
    height: int


CELL_TABLE = named(CellTable, F2, int8[::1], S1, S1, F1, float64, int64, int64)
FOUND: Any = types.UniTuple(int64, 2)  # type: ignore[no-untyped-call]
FOUND_PAIR: Any = types.UniTuple(int64, 3)  # type: ignore[no-untyped-call]


@njit(
    [FOUND(float64, float64, int64, CELL_TABLE, float64, int64)],
    cache=True,
    nogil=True,
    error_model="numpy",
    inline="always",
)
def cheapest(
    x: float,
    y: float,
    price: int,
    table: CellTable,
    tolerance: float,
    best: int,
) -> tuple[int, int]:
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


@njit(
    [FOUND_PAIR(F2, int8[::1], S1, int64, CELL_TABLE, float64, int64)],
    cache=True,
    nogil=True,
    error_model="numpy",
)
def match(
    points: Array,
    prices: NDArray[np.int8],
    order: NDArray[np.int32],
    count: int,
    table: CellTable,
    tolerance: float,
    best: int,
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
