"""Matching: finds the configurations of the arm's segments that meet at the goal, within the tolerances.

Rigid motions preserve distances. So the arm may be cut anywhere: the tip is as far from the goal as the frames on both
sides of the cut are from each other. A match compares the frames compose(outer, inner) with the frames of an index, in
all cells that are near. Outer and inner are configurations of two segments, or one of them is the goal. There is one
cell walk for positions and poses, compiled for each case.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int32, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel, load
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, I2, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.obstacles.scene import Scene, collides, for_scenes
from hyperbit.controller.search.lists.cells import GRID, INDEX, Grid, Index, corner_offsets, write_point
from hyperbit.controller.search.lists.segment import SIDE, Side, compose
from hyperbit.controller.search.solution import EPSILON
from hyperbit.controller.search.target import QUERY, SearchQuery, reaches

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Work of looking up a product, and of verifying a pair without and with obstacles. A comparison with a point counts 1.
LOOKUP, VERIFIED, CLEARED = 4, 200, 1600


class Matches(NamedTuple):
    """The cheapest matches found so far."""

    rows: Integers  # rows in outer, inner and index, shape (n, 3)
    costs: Array  # shape (n,); infinite for an empty place
    squares: Array  # squared errors, shape (n,)


class Sides(NamedTuple):
    """What is matched: configurations of two segments, or the goal in place of one, with the rows of an index."""

    outer: Side
    inner: Side
    lookup: Index


class Pair(NamedTuple):
    """A pair that may be a match: its rows in outer, inner and index, its cost and its squared error."""

    outer: int
    inner: int
    row: int
    cost: float
    square: float


class Span(NamedTuple):
    """The part of outer and inner to match. The rows of inner must be in the order of their costs."""

    outer: int  # first row of outer
    outer_end: int  # row after the last of outer
    inner: int  # first row of inner
    inner_end: int  # row after the last of inner
    low: float  # least sum of the costs of an outer and an inner row
    high: float  # the sum must be less


MATCHES = named(Matches, I2, F1, F1)
SIDES = named(Sides, SIDE, SIDE, INDEX)
PAIR = named(Pair, int64, int64, int32, float64, float64)
SPAN = named(Span, int64, int64, int64, int64, float64, float64)
RANGE: Any = types.UniTuple(int64, 2)  # type: ignore[no-untyped-call]
POINT: Any = types.UniTuple(float64, 3)  # type: ignore[no-untyped-call]


@kernel(types.void(I1, I1, SIDE, int64), **UNCOUNTED)
def put(states: Configuration, seed: Configuration, side: Side, n: int) -> None:
    """Writes the states of a side's row `n` to `states` (B,), for all modules of the side; see Segment."""
    for i in range(side.first, side.last):
        states[i] = seed[i]
    row = side.rows[n]
    while row > 0:
        states[side.modules[row]] = side.choices[row]
        row = side.parents[row]


@kernel(float64(F2, int64, F2, int64), inline="always")
def chord(a: Array, i: int, b: Array, j: int) -> float:
    """Returns the squared chord between the rotations of frames a[i] and b[j]."""
    total = 0.0
    if a.shape[1] == 4:
        total = (a[i, 2] - b[j, 2]) ** 2 + (a[i, 3] - b[j, 3]) ** 2
    else:
        for k in range(3, 12):
            total += 0.5 * (a[i, k] - b[j, k]) ** 2
    return total


@kernel([POINT(F2, int64, F2, int64, float64)], inline="always")
def planar_point(a: Array, i: int, b: Array, j: int, scale: float) -> tuple[float, float, float]:
    """Returns the point of the product of planar frames a[i] and b[j], see write_point."""
    c, s = a[i, 2], a[i, 3]
    x, y = a[i, 0] + c * b[j, 0] - s * b[j, 1], a[i, 1] + s * b[j, 0] + c * b[j, 1]
    return x, y, scale * (s * b[j, 2] + c * b[j, 3])


@kernel([POINT(F2, int64, F2, int64)], inline="always")
def spatial_position(a: Array, i: int, b: Array, j: int) -> tuple[float, float, float]:
    """Returns the position of the product of spatial frames a[i] and b[j]."""
    return (
        a[i, 0] + a[i, 3] * b[j, 0] + a[i, 4] * b[j, 1] + a[i, 5] * b[j, 2],
        a[i, 1] + a[i, 6] * b[j, 0] + a[i, 7] * b[j, 1] + a[i, 8] * b[j, 2],
        a[i, 2] + a[i, 9] * b[j, 0] + a[i, 10] * b[j, 1] + a[i, 11] * b[j, 2],
    )


@kernel(int64(GRID, float64, float64, float64, F2, int64), inline="always")
def cell_at(grid: Grid, x: float, y: float, z: float, point: Array, size: int) -> int:
    """Returns the first cell to compare with a point, -1 outside the grid; point[0] has coordinates 4 to `size`."""
    origin, shape, strides, per = grid.origin, grid.shape, grid.strides, grid.per
    u, v, w = (x - origin[0]) * per + 0.5, (y - origin[1]) * per + 0.5, (z - origin[2]) * per + 0.5
    if not (0.0 <= u < shape[0] and 0.0 <= v < shape[1]):
        return -1
    cell = int(u) + strides[1] * int(v)
    if size >= 3:
        if not 0.0 <= w < shape[2]:
            return -1
        cell += strides[2] * int(w)
    if size == 6:
        for d in range(3, 6):
            w = (point[0, d] - origin[d]) * per + 0.5
            if not 0.0 <= w < shape[d]:
                return -1
            cell += strides[d] * int(w)
    return int(cell)


@kernel([RANGE(F1, float64, SPAN, float64, float64, int64, int64)], inline="always")
def affordable(
    costs: Array, own: float, span: Span, least: float, ceiling: float, low: int, high: int
) -> tuple[int, int]:
    """Returns the first inner row to match with an outer row, and the row after the last.

    Args:
        costs: costs of the inner rows.
        own: cost of the outer row.
        span: the rows to match.
        least: least cost of a row of the index.
        ceiling: greatest cost of a match.
        low: first inner row for an outer row that is not dearer.
        high: row after the last for this outer row.
    """
    while low > span.inner and own + costs[low - 1] >= span.low:
        low -= 1
    while high > low and not (own + costs[high - 1] < span.high and own + costs[high - 1] + least <= ceiling):
        high -= 1
    return low, high


@kernel([float64(MATCHES)], inline="always")
def most_cost(matches: Matches) -> float:
    """Returns the greatest cost of a pair that may replace a match. Ties count if there is one place only."""
    worst = matches.costs.max()
    return float(worst * (1 + EPSILON) if len(matches.costs) == 1 else np.nextafter(worst, -np.inf))


@kernel(
    for_scenes(lambda scene: types.boolean(PAIR, SIDES, QUERY, I1, scene, I1, MATCHES)),
    **UNCOUNTED,
)
def keep(
    pair: Pair,
    sides: Sides,
    query: SearchQuery,
    seed: Configuration,
    scene: Scene | None,
    states: Configuration,
    matches: Matches,
) -> bool:
    """Writes a pair to `matches` if it is better, within the tolerances, and clear; returns whether it was written.

    If there is one place, ties of the cost are broken by distance. `states` (B,) is scratch.
    """
    slot = 0
    if len(matches.costs) > 1:
        slot = int(np.argmax(matches.costs))
    elif pair.cost >= matches.costs[0] * (1 - EPSILON) and pair.square >= matches.squares[0]:
        return False
    put(states, seed, sides.outer, pair.outer)
    put(states, seed, sides.inner, pair.inner)
    put(states, seed, sides.lookup.side, pair.row)
    if not reaches(query, states):
        return False
    if scene is not None and collides(scene, states):
        return False
    matches.rows[slot, 0], matches.rows[slot, 1], matches.rows[slot, 2] = pair.outer, pair.inner, pair.row
    matches.costs[slot], matches.squares[slot] = pair.cost, pair.square
    return True


MATCH = for_scenes(lambda scene: int64(SIDES, SPAN, QUERY, I1, scene, MATCHES))


def matcher(planar: bool, posed: bool) -> Callable[..., int]:
    """Returns the matching kernel for planar or spatial arms, positions or poses.

    The kernel keeps the pairs of a span that are within the tolerances, clear, and cheaper than the dearest match. It
    returns its work in comparisons.
    """
    size = (3 if planar else 6) if posed else (2 if planar else 3)

    @kernel(MATCH, error_model="numpy", fastmath={"contract"})
    def match(
        sides: Sides, span: Span, query: SearchQuery, seed: Configuration, scene: Scene | None, matches: Matches
    ) -> int:
        outer, inner, index = sides
        a, b, points, costs, starts = outer.frames, inner.frames, index.points, index.costs, index.starts
        near, bounds, grid, scale = index.near, index.bounds, index.grid, index.rotation_scale
        frame, point, states = np.empty((1, a.shape[1])), np.empty((1, 6)), np.empty(len(seed), np.int64)
        # A match compares two cells along each coordinate. Along the first coordinate their points are contiguous.
        corners, farthest = corner_offsets(grid, 1, size), query.radius * query.radius
        low, high, before, ceiling = span.inner_end, span.inner_end, -np.inf, most_cost(matches)
        work = span.outer_end - span.outer
        for o in range(span.outer, span.outer_end):
            own = outer.costs[o]
            if own < before:
                low = high = span.inner_end
            before = own
            low, high = affordable(inner.costs, own, span, index.least, ceiling, low, high)
            work += LOOKUP * (high - low)
            for i in range(low, high):
                if planar:
                    x, y, z = planar_point(a, o, b, i, scale)
                elif posed:
                    compose(a, o, b, i, frame, 0)
                    write_point(frame, 0, scale, point, 0)
                    x, y, z = point[0, 0], point[0, 1], point[0, 2]
                else:
                    x, y, z = spatial_position(a, o, b, i)
                cell, price = cell_at(grid, x, y, z, point, size), own + inner.costs[i]
                if cell < 0 or (size < 6 and price + bounds[near[cell]] > ceiling):
                    continue
                for corner in range(len(corners)):
                    row = cell + corners[corner]
                    work += starts[row + 2] - starts[row]
                    for k in range(starts[row], starts[row + 2]):
                        if price + costs[k] > ceiling:
                            continue
                        square = (x - points[k, 0]) ** 2 + (y - points[k, 1]) ** 2
                        if not planar:
                            square += (z - points[k, 2]) ** 2
                        if square > farthest:
                            continue
                        if posed or query.weight > 0.0:
                            compose(a, o, b, i, frame, 0)
                            apart = chord(frame, 0, index.side.frames, index.order[k])
                            if posed and apart > query.chord:
                                continue
                            square += query.weight * query.weight * apart
                        pair = Pair(o, i, index.order[k], price + costs[k], square)
                        work += VERIFIED if scene is None else CLEARED
                        if keep(pair, sides, query, seed, scene, states, matches):
                            ceiling = most_cost(matches)
        return work

    return match


MATCHERS = {(planar, posed): matcher(planar, posed) for planar in (True, False) for posed in (False, True)}


def load_matchers(planar: bool) -> None:
    """Loads the kernels for planar or for spatial arms; each takes memory. A match without it loads its own."""
    for posed in (False, True):
        load(MATCHERS[planar, posed])


def match(sides: Sides, *rest: Any) -> int:
    """Calls the kernel for these sides, for positions or poses by the index; returns its work in comparisons."""
    return MATCHERS[sides.outer.frames.shape[1] == 4, bool(sides.lookup.rotation_scale > 0.0)](sides, *rest)
