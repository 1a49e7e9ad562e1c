"""A spatial index: the rows of a segment, sorted into cells by the position, or the pose, of their frames.

For poses the cells have rotation coordinates beside the position. Half the vector of R - R^T is the rotation axis times
the sine of the angle. It changes by at most the chord between two rotations. A scale makes the greatest chord as long
as the greatest distance. In the plane the coordinate is the sine of the angle; in space there are three.
"""

from typing import NamedTuple

import numpy as np
from numba import float64, int32, njit, uint8
from numpy.typing import NDArray

from controller.search.frame_rows import F1, F2, I1, SIDE, Side, named

Array = NDArray[np.float64]
Index32 = NDArray[np.int32]

CELLS = 1 << 17
POINTS_A_CELL = 0.5  # least mean number of points in a cell
LEAST_SIDE = 1e-300  # its inverse is finite
NOTHING = 255  # cost level of cells without points
MARGIN = 1 + 1e-6  # factor of the side: rounding must not put two near points more than one cell apart


class Index(NamedTuple):
    """Points in the order of their cells.

    Attributes:
        points: shape (n, size).
        costs: costs of the points, shape (n,).
        starts: first point of each cell, shape (cells + 1,). A border of empty cells surrounds all points.
        order: row of each point in the side, shape (n,).
        near: least cost level of the cells that a match compares: a cell and the next one along each coordinate;
            NOTHING if they are empty. Not used for six coordinates.
        bounds: least cost of each level, shape (256,).
        origin: least corner of the points, shape (6,).
        shape: number of cells along each coordinate, less one, shape (6,).
        strides: difference of the numbers of adjacent cells along each coordinate, shape (6,).
        per: cells per unit of length.
        rotation_scale: length of a rotation axis of unit size; 0 for cells of positions only.
        least: least cost.
        side: the configurations.
    """

    points: Array
    costs: Array
    starts: Index32
    order: Index32
    near: NDArray[np.uint8]
    bounds: Array
    origin: Array
    shape: Array
    strides: NDArray[np.int64]
    per: float
    rotation_scale: float
    least: float
    side: Side


INDEX = named(Index, F2, F1, int32[::1], int32[::1], uint8[::1], F1, F1, F1, I1, float64, float64, float64, SIDE)


class Cells:
    """Memory for an index. It is reused, as page faults of fresh memory would take longer than the writes.

    Args:
        most: greatest number of points.
        size: coordinates of a position, 2 or 3.
        cells: greatest number of cells.
    """

    def __init__(self, most: int, size: int, cells: int = CELLS) -> None:
        self._starts, self._cells = np.empty(cells + 2, dtype=np.int32), np.empty(most, dtype=np.int32)
        self._near = np.empty(cells + 1, dtype=np.uint8)
        self._order, self._costs = np.empty(most, dtype=np.int32), np.empty(most)
        self._size, self._whole = size, 3 if size == 2 else 6
        self._points, self._unsorted = np.empty(most * self._whole), np.empty(most * self._whole)

    def claim(self, most: int | None = None) -> None:
        """Touches the memory for `most` positions, or for all, so that no search waits for page faults."""
        self._starts.fill(0)
        self._near.fill(0)
        for array in (self._cells, self._order, self._costs):
            array[:most].fill(0)
        self._points[: most and most * self._size].fill(0)

    def fill(self, side: Side, radius: float, chord: float = np.inf, cells: int | None = None) -> Index:
        """Returns the index of a side. The side must not change while the index is in use.

        Args:
            side: n configurations.
            radius: greatest distance of a match.
            chord: greatest squared chord of a match, see SearchTarget; infinite without orientation.
            cells: number of cells to aim at; None: in proportion to the points.
        """
        n, size, scale, points = len(side.costs), self._size, 0.0, side.frames
        if chord < np.inf:
            size, scale = self._whole, radius / np.sqrt(chord)
            points = self._unsorted[: n * size].reshape(n, size)
            write_points(side.frames, scale, points)
        own, costs = self._points[: n * size].reshape(n, size), self._costs[:n]
        grid, strides = np.empty(13), np.empty(6, dtype=np.int64)
        most = n / POINTS_A_CELL + 64 if cells is None else cells
        near = self._near if size < 6 else self._near[:1]
        least, most_cost = (float(side.costs.min()), float(side.costs.max())) if n else (np.inf, np.inf)
        bounds = np.full(256, least)
        if most_cost > least:
            bounds += np.arange(256) * ((most_cost - least) / (NOTHING - 1))
        bounds[NOTHING] = np.inf
        given, table = (points, side.costs, size, radius, most, bounds), (self._starts, near, grid, strides)
        count = sort_into_cells(*given, self._cells, *table, self._order, own, costs)
        starts, order = self._starts[: count + 2], self._order[:n]
        return Index(
            own, costs, starts, order, near, bounds, grid[:6], grid[6:12], strides, float(grid[12]), scale, least, side
        )


@njit("void(f8[:,::1], i8, f8, f8[:,::1], i8)", cache=True, nogil=True, inline="always")
def write_point(frames: Array, n: int, scale: float, points: Array, k: int) -> None:
    """Writes position and scaled rotation axis of frames[n] to points[k]: 3 coordinates in the plane, 6 in space."""
    if frames.shape[1] == 4:
        points[k, 0], points[k, 1], points[k, 2] = frames[n, 0], frames[n, 1], scale * frames[n, 3]
    else:
        points[k, 0], points[k, 1], points[k, 2] = frames[n, 0], frames[n, 1], frames[n, 2]
        points[k, 3] = 0.5 * scale * (frames[n, 10] - frames[n, 8])
        points[k, 4] = 0.5 * scale * (frames[n, 5] - frames[n, 9])
        points[k, 5] = 0.5 * scale * (frames[n, 6] - frames[n, 4])


@njit("void(f8[:,::1], f8, f8[:,::1])", cache=True, nogil=True)
def write_points(frames: Array, scale: float, points: Array) -> None:
    """Writes the points (n, 3 or 6) of frames (n, 4 or 12), see write_point."""
    for n in range(len(frames)):
        write_point(frames, n, scale, points, n)


@njit(
    "i8(f8[:,::1], f8[::1], i8, f8, f8, f8[::1],"
    " i4[::1], i4[::1], u1[::1], f8[::1], i8[::1], i4[::1], f8[:,::1], f8[::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def sort_into_cells(
    rows: Array,
    costs: Array,
    size: int,
    radius: float,
    most: float,
    bounds: Array,
    cells: Index32,
    starts: Index32,
    near: NDArray[np.uint8],
    grid: Array,
    strides: NDArray[np.int64],
    order: Index32,
    points: Array,
    prices: Array,
) -> int:
    """Sorts points into cells at least two radii wide; returns the number of cells.

    Args:
        rows: rows that begin with the coordinates of a point, shape (n, ...).
        costs: costs of the points, shape (n,).
        size: number of coordinates of a point, at most 6.
        radius: greatest distance of a match.
        most: greatest number of cells.
        bounds: see Index.
        cells: scratch, shape (n,).
        starts: written, see Index, shape (cells + 2,).
        near: written, see Index; skipped if the shape is (1,).
        grid: written: origin (6,), shape (6,), per, see Index.
        strides: written, see Index.
        order: written, see Index.
        points: written, see Index.
        prices: written, see `costs` of Index.
    """
    low, high, shape = np.zeros(6), np.zeros(6), np.ones(6)
    for a in range(size):
        low[a], high[a] = (np.inf, -np.inf) if len(rows) else (0.0, 0.0)
    for n in range(len(rows)):
        for a in range(size):
            low[a], high[a] = min(low[a], rows[n, a]), max(high[a], rows[n, a])
    most = min(most, len(starts) - 2)
    side = max(2.0 * radius * MARGIN, LEAST_SIDE)
    while True:
        product, finest = 1.0, 0.0
        for a in range(size):
            shape[a] = np.floor((high[a] - low[a]) / side) + 3.0
            product *= shape[a]
            finest = max(finest, shape[a])
        if product <= most or finest == 3.0:
            break
        side *= 1.25
    per, step, count = 1.0 / side, 1, int(product)
    grid[12] = per
    for a in range(6):
        grid[a], grid[6 + a], strides[a] = low[a], shape[a] - 1.0, step
        step *= int(shape[a])
    mapped = len(near) > 1
    for c in range(count + 2):
        starts[c] = 0
    if mapped:
        for c in range(count):
            near[c] = NOTHING
    finer = 1.0 / (bounds[1] - bounds[0]) if bounds[1] > bounds[0] else 0.0
    for n in range(len(rows)):
        c = 0
        for a in range(size):
            # Rounding may put the outermost points just outside.
            c += strides[a] * min(1 + int((rows[n, a] - low[a]) * per), int(shape[a]) - 2)
        cells[n] = c
        starts[c] += 1
        if mapped:
            level = min(int((costs[n] - bounds[0]) * finer), NOTHING - 1)
            if bounds[level] > costs[n]:  # by rounding
                level -= 1
            for corner in range(1 << size):
                other = c
                for a in range(size):
                    other -= strides[a] * ((corner >> a) & 1)
                near[other] = min(near[other], level)
    for c in range(count + 1):
        starts[c + 1] += starts[c]
    for n in range(len(rows) - 1, -1, -1):
        starts[cells[n]] -= 1
        at = starts[cells[n]]
        order[at], prices[at] = n, costs[n]
        for a in range(size):
            points[at, a] = rows[n, a]
    return count
