"""Points sorted into cells, so that what is near is found in the cells around."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index32 = NDArray[np.int32]

# What kernels ask: points in the order of their cells, their costs, where each cell's points begin, the rows they are
# of, the cells' grid, and all rows, for their rotations.
Sorted = tuple[Array, Array, Index32, Index32, Array, Array]
SORTED = "Tuple((f8[:,::1], f8[::1], i4[::1], i4[::1], f8[::1], f8[:,::1]))"

CELLS = 1 << 17
POINTS_A_CELL = 0.5  # at least, on the average
LEAST_SIDE = 1e-300  # one over it is finite still


@njit("i8(f8[:,::1], i8, f8, i4[::1], i4[::1], f8[::1])", cache=True, nogil=True, error_model="numpy")
def sort_into_cells(rows: Array, size: int, tolerance: float, starts: Index32, cells: Index32, grid: Array) -> int:
    """Counts points into cells at least two tolerances wide; returns the cells' number.

    Args:
        rows: each begins with a point's coordinates, shape (n, ...).
        size: how many they are, at most 6.
        tolerance: of the questions to come.
        starts: written: where each cell's points end, shape (cells + 1,).
        cells: written: the cell of each point, shape (n,).
        grid: written: the least corner (6,), cells per unit of length, cells along each coordinate (6,).
    """
    low, high, shape = np.zeros(6), np.zeros(6), np.ones(6)
    for a in range(size):
        low[a], high[a] = np.inf, -np.inf
    for n in range(len(rows)):
        for a in range(size):
            low[a], high[a] = min(low[a], rows[n, a]), max(high[a], rows[n, a])
    most = min(len(starts) - 1, len(rows) / POINTS_A_CELL + 64)
    side = max(2.0 * tolerance * (1 + 1e-9), LEAST_SIDE)  # with room for rounding
    while True:
        product = 1.0
        for a in range(size):
            shape[a] = np.floor((high[a] - low[a]) / side) + 1.0
            product *= shape[a]
        if product <= most:
            break
        side *= 1.25
    per = 1.0 / side
    grid[6] = per
    for a in range(6):
        grid[a], grid[7 + a] = low[a], shape[a]
    count = int(product)
    for c in range(count + 1):
        starts[c] = 0
    for n in range(len(rows)):
        c = 0
        for a in range(size - 1, -1, -1):
            # Rounding may put the outermost just outside.
            c = c * int(shape[a]) + min(int((rows[n, a] - low[a]) * per), int(shape[a]) - 1)
        cells[n] = c
        starts[c] += 1
    for c in range(count):
        starts[c + 1] += starts[c]
    return count


@njit(
    "void(f8[:,::1], f8[::1], i4[::1], i4[::1], i4[::1], f8[:,::1], f8[::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def put_into_cells(
    rows: Array, costs: Array, starts: Index32, cells: Index32, order: Index32, points: Array, prices: Array
) -> None:
    """Copies points and costs in the order of their cells, after sort_into_cells; `starts` are then starts.

    Args:
        rows: see sort_into_cells.
        costs: of the rows, shape (n,).
        starts: see sort_into_cells.
        cells: see sort_into_cells.
        order: written: the row of each point, shape (n,).
        points: written, as many coordinates as were sorted by, shape (n, ...).
        prices: written, shape (n,).
    """
    for n in range(len(rows) - 1, -1, -1):
        c = cells[n]
        starts[c] -= 1
        at = starts[c]
        order[at], prices[at] = n, costs[n]
        for a in range(points.shape[1]):
            points[at, a] = rows[n, a]
