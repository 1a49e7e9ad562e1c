"""Matching: finds the configurations of the arm's segments that meet at the goal, within the tolerances.

Rigid motions preserve distances. So the arm may be cut anywhere: the tip is as far from the goal as the frames on both
sides of the cut are from each other. A match compares the frames compose(outer, inner) with the frames of an index, in
all cells that are near. Outer and inner are configurations of two segments, or one of them is the goal. There is one
cell walk for positions and poses, compiled for each case.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, njit, types
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.obstacles.scene import Scene, collides, for_scenes
from controller.search.cells import INDEX, Index, write_point
from controller.search.frame_rows import F1, F2, I1, I2, SIDE, Side, compose, named
from controller.search.solution import EPSILON
from controller.search.target import QUERY, SearchQuery, reaches

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Found(NamedTuple):
    """The cheapest matches found so far.

    Attributes:
        rows: rows in outer, inner and index, shape (n, 3).
        costs: shape (n,); infinite for an empty place.
        squares: squared errors, shape (n,).
    """

    rows: Integers
    costs: Array
    squares: Array


FOUND = named(Found, I2, F1, F1)


class Span(NamedTuple):
    """The part of outer and inner to match. The rows of inner must be in the order of their costs.

    Attributes:
        outer: first row of outer.
        outer_end: row after the last of outer.
        inner: first row of inner.
        inner_end: row after the last of inner.
        low: least sum of the costs of an outer and an inner row.
        high: the sum must be less.
    """

    outer: int
    outer_end: int
    inner: int
    inner_end: int
    low: float
    high: float


SPAN = named(Span, int64, int64, int64, int64, float64, float64)


@njit(types.void(I1, I1, SIDE, int64), cache=True, nogil=True)
def put(states: Configuration, seed: Configuration, side: Side, n: int) -> None:
    """Writes the states of a side's row `n` to `states` (B,), for all modules of the side; see Segment."""
    for i in range(side.first, side.last):
        states[i] = seed[i]
    row = side.rows[n]
    while row > 0:
        states[side.modules[row]] = side.choices[row]
        row = side.parents[row]


@njit(float64(F2, int64, F2, int64), cache=True, nogil=True, inline="always")
def chord(a: Array, i: int, b: Array, j: int) -> float:
    """Returns the squared chord between the rotations of frames a[i] and b[j]."""
    total = 0.0
    if a.shape[1] == 4:
        total = (a[i, 2] - b[j, 2]) ** 2 + (a[i, 3] - b[j, 3]) ** 2
    else:
        for k in range(3, 12):
            total += 0.5 * (a[i, k] - b[j, k]) ** 2
    return total


@cache
def kernel(planar: bool, posed: bool) -> Callable[..., None]:
    """Returns the matching kernel for planar or spatial arms, positions or poses.

    The kernel writes to Found the pairs that are within the tolerances, clear, and cheaper than the dearest found. If
    Found has one place, ties of the cost are broken by distance. A pair is collision-checked only if it would improve
    Found.
    """
    place = 2 if planar else 3
    size = (3 if planar else 6) if posed else place

    @njit(
        for_scenes(lambda scene: types.void(SIDE, SIDE, INDEX, SPAN, QUERY, I1, scene, FOUND)),
        cache=True,
        nogil=True,
        error_model="numpy",
        fastmath={"contract"},
    )
    def match(
        outer: Side,
        inner: Side,
        index: Index,
        span: Span,
        query: SearchQuery,
        seed: Configuration,
        scene: Scene | None,
        found: Found,
    ) -> None:
        a, b, points, costs, starts = outer.frames, inner.frames, index.points, index.costs, index.starts
        near, bounds = index.near, index.bounds
        width, room, farthest = a.shape[1], len(found.costs), query.radius * query.radius
        worst = found.costs.max()
        ceiling = worst * (1 + EPSILON) if room == 1 else worst
        frame, point, states = np.empty((1, width)), np.empty((1, 6)), np.empty(len(seed), np.int64)
        least, per, scale, origin, strides = index.least, index.per, index.rotation_scale, index.origin, index.strides
        x0, y0, z0, nx, ny, nz = origin[0], origin[1], origin[2], index.shape[0], index.shape[1], index.shape[2]
        # A match compares two cells along each coordinate. Along the first coordinate their points are contiguous.
        corners = np.zeros(1 << (size - 1), np.int64)
        for corner in range(len(corners)):
            for d in range(1, size):
                corners[corner] += strides[d] * ((corner >> (d - 1)) & 1)
        low = high = span.inner_end
        before = -np.inf
        for o in range(span.outer, span.outer_end):
            own = outer.costs[o]
            if own < before:
                low = high = span.inner_end
            before = own
            while low > span.inner and own + inner.costs[low - 1] >= span.low:
                low -= 1
            while high > low:
                price = own + inner.costs[high - 1]
                if price < span.high and price + least <= ceiling:
                    break
                high -= 1
            for i in range(low, high):
                z = 0.0
                if planar:
                    c, s = a[o, 2], a[o, 3]
                    x = a[o, 0] + c * b[i, 0] - s * b[i, 1]
                    y = a[o, 1] + s * b[i, 0] + c * b[i, 1]
                    if posed:
                        z = scale * (s * b[i, 2] + c * b[i, 3])
                elif posed:
                    compose(a, o, b, i, frame, 0)
                    write_point(frame, 0, scale, point, 0)
                    x, y, z = point[0, 0], point[0, 1], point[0, 2]
                else:
                    x = a[o, 0] + a[o, 3] * b[i, 0] + a[o, 4] * b[i, 1] + a[o, 5] * b[i, 2]
                    y = a[o, 1] + a[o, 6] * b[i, 0] + a[o, 7] * b[i, 1] + a[o, 8] * b[i, 2]
                    z = a[o, 2] + a[o, 9] * b[i, 0] + a[o, 10] * b[i, 1] + a[o, 11] * b[i, 2]
                u, v = (x - x0) * per + 0.5, (y - y0) * per + 0.5
                if not (0.0 <= u < nx and 0.0 <= v < ny):
                    continue
                price = own + inner.costs[i]
                cell = int(u) + strides[1] * int(v)
                if size >= 3:
                    w = (z - z0) * per + 0.5
                    if not 0.0 <= w < nz:
                        continue
                    cell += strides[2] * int(w)
                if size == 6:
                    inside = True
                    for d in range(3, 6):
                        w = (point[0, d] - origin[d]) * per + 0.5
                        inside = inside and 0.0 <= w < index.shape[d]
                        cell += strides[d] * int(w)
                    if not inside:
                        continue
                elif price + bounds[near[cell]] > ceiling:
                    continue
                for corner in range(len(corners)):
                    row = cell + corners[corner]
                    for k in range(starts[row], starts[row + 2]):
                        cost = price + costs[k]
                        if cost > ceiling:
                            continue
                        square = (x - points[k, 0]) ** 2 + (y - points[k, 1]) ** 2
                        if not planar:
                            square += (z - points[k, 2]) ** 2
                        if square > farthest:
                            continue
                        n = index.order[k]
                        if posed or query.weight > 0.0:
                            compose(a, o, b, i, frame, 0)
                            apart = chord(frame, 0, index.side.frames, n)
                            if posed and apart > query.chord:
                                continue
                            square += query.weight * query.weight * apart
                        slot = 0
                        if room == 1:
                            if cost >= worst * (1 - EPSILON) and square >= found.squares[0]:
                                continue
                        else:
                            if cost >= worst:
                                continue
                            slot = int(np.argmax(found.costs))
                        put(states, seed, outer, o)
                        put(states, seed, inner, i)
                        put(states, seed, index.side, n)
                        if not reaches(query, states):
                            continue
                        if scene is not None and collides(scene, states):
                            continue
                        found.rows[slot, 0], found.rows[slot, 1], found.rows[slot, 2] = o, i, n
                        found.costs[slot], found.squares[slot] = cost, square
                        worst = found.costs.max()
                        ceiling = worst * (1 + EPSILON) if room == 1 else worst

    return match


KERNEL_VARIANTS = [(planar, posed) for planar in (True, False) for posed in (False, True)]


def load(planar: bool) -> None:
    """Loads the kernels for planar or for spatial arms; each takes memory. A match without it loads its own."""
    for posed in (False, True):
        kernel(planar, posed)


def match(outer: Side, inner: Side, index: Index, *rest: Any) -> None:
    """Calls the kernel for these sides, for positions or poses by the index."""
    kernel(outer.frames.shape[1] == 4, index.rotation_scale > 0.0)(outer, inner, index, *rest)
