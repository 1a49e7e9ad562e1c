"""Matches the points of one list with near points of another list, which is sorted into cells."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.bench.methods.planar import Array

# Points, prices, starts and rows of the cells, lower corner, side, and number of cells in x and y: see Cells.
Table = tuple[Array, NDArray[np.int8], NDArray[np.int32], NDArray[np.int32], Array, float, int, int]
TABLE = "Tuple((f8[:,::1], i1[::1], i4[::1], i4[::1], f8[::1], f8, i8, i8))"


@njit(
    f"UniTuple(i8, 2)(f8, f8, i8, {TABLE}, f8, i8)",
    cache=True,
    nogil=True,
    error_model="numpy",
    inline="always",
)
def cheapest(
    x: float,
    y: float,
    price: int,
    table: Table,
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
    f"UniTuple(i8, 3)(f8[:,::1], i1[::1], i4[::1], i8, {TABLE}, f8, i8)",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def match(
    points: Array,
    prices: NDArray[np.int8],
    order: NDArray[np.int32],
    count: int,
    table: Table,
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
