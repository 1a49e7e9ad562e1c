"""A spatial index: the rows of a segment, sorted into cells by the position, or the pose, of their frames.

For poses the cells have rotation coordinates beside the position. Half the vector of R - R^T is the rotation axis times
the sine of the angle. It changes by at most the chord between two rotations. A scale makes the greatest chord as long
as the greatest distance. In the plane the coordinate is the sine of the angle; in space there are three.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, types, uint8
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, S1, named
from hyperbit.controller.search.clock import INDEXED
from hyperbit.controller.search.lists.segment import SIDE, Side

Array = NDArray[np.float64]
Index32 = NDArray[np.int32]

CELLS = 1 << 17
POINTS_A_CELL = 0.5  # least mean number of points in a cell
LEAST_SIDE = 1e-300  # its inverse is finite
NOTHING = 255  # cost level of cells without points
MARGIN = 1 + 1e-6  # factor of the side: rounding must not put two near points more than one cell apart


class Grid(NamedTuple):
    """Cells of one width along all coordinates of a point, at most six. Empty cells surround all points."""

    origin: tuple[float, ...]  # least corner of the points
    shape: tuple[float, ...]  # number of cells along each coordinate, less one
    strides: tuple[int, ...]  # difference of the numbers of adjacent cells along each coordinate
    per: float  # cells per unit of length
    cells: int  # number of cells


class SortedPoints(NamedTuple):
    """Points in the order of their cells, as the kernel writes them."""

    starts: Index32  # first point of each cell, shape (cells + 2,)
    order: Index32  # number of each point before, shape (n,)
    points: Array  # shape (n, size)
    costs: Array  # shape (n,)


class Index(NamedTuple):
    """Points in the order of their cells."""

    points: Array  # shape (n, size)
    costs: Array  # costs of the points, shape (n,)
    starts: Index32  # first point of each cell, shape (cells + 2,)
    order: Index32  # row of each point in the side, shape (n,)
    # least cost level of the cells that a match compares: a cell and the next one along each coordinate; NOTHING if
    # they are empty. Not used for six coordinates.
    near: NDArray[np.uint8]
    bounds: Array  # least cost of each level, shape (256,)
    grid: Grid  # the cells
    rotation_scale: float  # length of a rotation axis of unit size; 0 for cells of positions only
    least: float  # least cost
    side: Side  # the configurations


SIX: Any = types.UniTuple(float64, 6)  # type: ignore[no-untyped-call]
GRID = named(Grid, SIX, SIX, types.UniTuple(int64, 6), float64, int64)  # type: ignore[no-untyped-call]
SORTED_POINTS = named(SortedPoints, S1, S1, F2, F1)
INDEX = named(Index, F2, F1, S1, S1, uint8[::1], F1, GRID, float64, float64, SIDE)


class Cells:
    """Memory for an index of up to `most` points in up to `cells` cells; positions have `size` coordinates.

    It is reused, as page faults of fresh memory would take longer than the writes.
    """

    def __init__(self, most: int, size: int, cells: int = CELLS) -> None:
        self._index: Index | None = None
        self._asked: tuple[float | None, ...] = ()  # of the index
        self._starts, self._cells = np.empty(cells + 2, dtype=np.int32), np.empty(most, dtype=np.int32)
        self._near = np.empty(cells + 1, dtype=np.uint8)
        self._order, self._costs = np.empty(most, dtype=np.int32), np.empty(most)
        self._size, self._whole = size, 3 if size == 2 else 6
        self._points, self._unsorted = np.empty(most * self._whole), np.empty(most * self._whole)

    def claim(self, most: int | None = None) -> None:
        """Touches the memory for `most` positions, or for all, so that no search waits for page faults."""
        self._index = None
        self._starts.fill(0)
        self._near.fill(0)
        for array in (self._cells, self._order, self._costs):
            array[:most].fill(0)
        self._points[: most and most * self._size].fill(0)

    def fill(self, side: Side, radius: float, chord: float = np.inf, cells: int | None = None) -> Index:
        """Returns the index of a side, whose frames must not change; the last one if all is the same.

        Args:
            side: n configurations.
            radius: greatest distance of a match.
            chord: greatest squared chord of a match, see SearchTarget; infinite without orientation.
            cells: number of cells to aim at; None: in proportion to the points.
        """
        last, asked = self._index, (radius, chord, cells)
        if last is not None and last.side.frames is side.frames and self._asked == asked:
            return last
        self._index = None  # until it is done
        n, size, scale, points = len(side.costs), self._size, 0.0, side.frames
        if chord < np.inf:
            size, scale = self._whole, radius / np.sqrt(chord)
            points = self._unsorted[: n * size].reshape(n, size)
            write_points(side.frames, scale, points)
        most = min(n / POINTS_A_CELL + 64 if cells is None else cells, len(self._starts) - 2)
        grid = grid_of(points, size, radius, most)
        table = SortedPoints(
            self._starts[: grid.cells + 2], self._order[:n], self._points[: n * size].reshape(n, size), self._costs[:n]
        )
        sort_into_cells(grid, points, side.costs, self._cells, table)
        least, bounds = cost_levels(side.costs)
        near = self._near if size < 6 else self._near[:1]
        if size < 6:
            mark_levels(grid, size, self._cells[:n], side.costs, bounds, near)
        found = Index(table.points, table.costs, table.starts, table.order, near, bounds, grid, scale, least, side)
        self._index, self._asked = found, asked
        return found


def filling(index: Index) -> float:
    """Returns the price of an index."""
    return INDEXED * (len(index.costs) + len(index.starts) / 8)


def cost_levels(costs: Array) -> tuple[float, Array]:
    """Returns the least of costs (n,), infinite if there are none, and the least cost of each level (256,)."""
    least, most = (float(costs.min()), float(costs.max())) if len(costs) else (np.inf, np.inf)
    bounds = np.full(256, least)
    if most > least:
        bounds += np.arange(256) * ((most - least) / (NOTHING - 1))
    bounds[NOTHING] = np.inf
    return least, bounds


@kernel("void(f8[:,::1], i8, f8, f8[:,::1], i8)", inline="always")
def write_point(frames: Array, n: int, scale: float, points: Array, k: int) -> None:
    """Writes position and scaled rotation axis of frames[n] to points[k]: 3 coordinates in the plane, 6 in space."""
    if frames.shape[1] == 4:
        points[k, 0], points[k, 1], points[k, 2] = frames[n, 0], frames[n, 1], scale * frames[n, 3]
    else:
        points[k, 0], points[k, 1], points[k, 2] = frames[n, 0], frames[n, 1], frames[n, 2]
        points[k, 3] = 0.5 * scale * (frames[n, 10] - frames[n, 8])
        points[k, 4] = 0.5 * scale * (frames[n, 5] - frames[n, 9])
        points[k, 5] = 0.5 * scale * (frames[n, 6] - frames[n, 4])


@kernel("void(f8[:,::1], f8, f8[:,::1])")
def write_points(frames: Array, scale: float, points: Array) -> None:
    """Writes the points (n, 3 or 6) of frames (n, 4 or 12), see write_point."""
    for n in range(len(frames)):
        write_point(frames, n, scale, points, n)


@kernel([GRID(F2, int64, float64, float64)], error_model="numpy")
def grid_of(rows: Array, size: int, radius: float, most: float) -> Grid:
    """Returns cells for points, at least two radii wide.

    Args:
        rows: rows that begin with the coordinates of a point, shape (n, ...).
        size: number of coordinates of a point, at most 6.
        radius: greatest distance of a match.
        most: greatest number of cells.
    """
    low, high, shape = np.zeros(6), np.zeros(6), np.ones(6)
    for a in range(size):
        low[a], high[a] = (np.inf, -np.inf) if len(rows) else (0.0, 0.0)
    for n in range(len(rows)):
        for a in range(size):
            low[a], high[a] = min(low[a], rows[n, a]), max(high[a], rows[n, a])
    width, product, finest = max(2.0 * radius * MARGIN, LEAST_SIDE), np.inf, np.inf
    while True:
        product, finest = 1.0, 0.0
        for a in range(size):
            shape[a] = np.floor((high[a] - low[a]) / width) + 3.0
            product *= shape[a]
            finest = max(finest, shape[a])
        if product <= most or finest == 3.0:
            break
        width *= 1.25
    strides = np.ones(6, dtype=np.int64)
    for a in range(5):
        strides[a + 1] = strides[a] * int(shape[a])
    return Grid(
        (low[0], low[1], low[2], low[3], low[4], low[5]),
        (shape[0] - 1.0, shape[1] - 1.0, shape[2] - 1.0, shape[3] - 1.0, shape[4] - 1.0, shape[5] - 1.0),
        (strides[0], strides[1], strides[2], strides[3], strides[4], strides[5]),
        1.0 / width,
        int(product),
    )


@kernel(types.void(GRID, F2, F1, S1, SORTED_POINTS), error_model="numpy")
def sort_into_cells(grid: Grid, rows: Array, costs: Array, cells: Index32, table: SortedPoints) -> None:
    """Sorts points into cells.

    Args:
        grid: the cells.
        rows: rows that begin with the coordinates of a point, shape (n, ...).
        costs: costs of the points, shape (n,).
        cells: written: cell of each point, shape (n,).
        table: written.
    """
    starts, order, points, sorted_costs = table
    origin, shape, strides, per = np.array(grid.origin), np.array(grid.shape), np.array(grid.strides), grid.per
    size = points.shape[1]
    for c in range(len(starts)):
        starts[c] = 0
    for n in range(len(rows)):
        c = 0
        for a in range(size):
            # Rounding may put the outermost points just outside.
            c += strides[a] * min(1 + int((rows[n, a] - origin[a]) * per), int(shape[a]) - 1)
        cells[n] = c
        starts[c] += 1
    for c in range(len(starts) - 1):
        starts[c + 1] += starts[c]
    for n in range(len(rows) - 1, -1, -1):
        starts[cells[n]] -= 1
        at = starts[cells[n]]
        order[at], sorted_costs[at] = n, costs[n]
        for a in range(size):
            points[at, a] = rows[n, a]


@kernel(I1(GRID, int64, int64))
def corner_offsets(grid: Grid, first: int, size: int) -> NDArray[np.int64]:
    """Returns by how much the number of a cell grows to the next cells along coordinates first+1 to `size`.

    There is one offset for each combination of coordinates, the first is 0.
    """
    offsets = np.zeros(1 << (size - first), np.int64)
    for corner in range(len(offsets)):
        for d in range(first, size):
            offsets[corner] += grid.strides[d] * ((corner >> (d - first)) & 1)
    return offsets


@kernel(types.void(GRID, int64, S1, F1, F1, uint8[::1]), error_model="numpy")
def mark_levels(grid: Grid, size: int, cells: Index32, costs: Array, bounds: Array, near: NDArray[np.uint8]) -> None:
    """Writes `near` of an index, from cells and costs (n,) of points of `size` coordinates, and the levels' bounds."""
    for c in range(grid.cells):
        near[c] = NOTHING
    corners, finer = corner_offsets(grid, 0, size), 1.0 / (bounds[1] - bounds[0]) if bounds[1] > bounds[0] else 0.0
    for n in range(len(cells)):
        level = min(int((costs[n] - bounds[0]) * finer), NOTHING - 1)
        if bounds[level] > costs[n]:  # by rounding
            level -= 1
        for corner in range(len(corners)):
            cell = cells[n] - corners[corner]
            near[cell] = min(near[cell], level)
