"""Asking a table of rows in cells for what is near: by one point, by listed ones, by all that a half can come to."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.bench.methods.planar import Array, Index, moved

# Points, prices, starts and rows of the cells, their lowest corner, side, and how many there are each way: see Cells.
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
    """Returns the row near (x, y) that costs least and the sum with `price`, if below `best`; else (-1, best)."""
    # A disc of the tolerance touches four cells at most, as they are two tolerances wide.
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


@njit(
    f"UniTuple(i8, 3)(f8, f8, f8[:,:,::1], i8[:,::1], i8[::1], i8, i8, {TABLE}, f8, i8)",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def go_through(
    x: float,
    y: float,
    motions: Array,
    costs: Index,
    states: Index,
    most: int,
    listed: int,
    table: Table,
    tolerance: float,
    best: int,
) -> tuple[int, int, int]:
    """Returns code, row and switches of the best pair; (-1, -1, best) if none is below `best`."""
    last = len(states) - 1
    found_code, found_row = -1, -1
    xs, ys = np.empty(last + 1), np.empty(last + 1)
    spent, codes = np.zeros(last + 1, dtype=np.int64), np.zeros(last + 1, dtype=np.int64)
    state = np.full(last + 1, -1)
    xs[0], ys[0], i = x, y, 0
    while i >= 0:
        state[i] += 1
        j = state[i]
        if j == states[i]:
            state[i] = -1
            i -= 1
            continue
        price = spent[i] + costs[i, j]
        if price > most or price >= best:
            continue
        px, py = moved(motions[i, j], xs[i], ys[i])
        code = codes[i] * states[i] + j
        if i < last:
            i += 1
            xs[i], ys[i], spent[i], codes[i] = px, py, price, code
        elif price > listed:
            row, best = cheapest(px, py, price, table, tolerance, best)
            if row >= 0:
                found_code, found_row = code, row
    return found_code, found_row, best
