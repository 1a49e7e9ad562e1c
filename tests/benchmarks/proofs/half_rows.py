"""Halves of an arm for the proofs: their configurations as points, listed and sorted into cells."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NONE = 1 << 30
CELLS = 1 << 22


class Half(NamedTuple):
    """Half an arm.

    Attributes:
        modules: in the order in which they move the half's point, shape (m,).
        motions: of a point (x, y, z), for each state, shape (m, K, 3, 4).
        states: numbers of states, shape (m,).
        costs: switches to each state, shape (m, K).
        order: of the states, fewest switches first, shape (m, K).
    """

    modules: Index
    motions: Array
    states: Index
    costs: Index
    order: Index


class Rows(NamedTuple):
    """Configurations of a half: points (n, 3), switches (n,) and mixed-radix codes (n,)."""

    points: Array
    costs: NDArray[np.int8]
    codes: Index


class Table(NamedTuple):
    """Rows sorted into cells, fewest switches first in each; cell c has rows `starts[c]` to `starts[c + 1]`.

    Attributes:
        rows: in the order of the cells.
        starts: shape (cells + 1,).
        low: least corner, shape (3,).
        least: fewest switches of any row in a cell or beside it, shape (cells,).
    """

    rows: Rows
    starts: Index
    low: Array
    side: float
    shape: Index
    least: NDArray[np.int8]


def halves(
    m: Manipulator, goal: Array, start: Configuration, tolerance: float, turn: float
) -> tuple[Half, Half, Array, Array]:
    """Returns both halves, the goal in frame F_0 and the tip in frame F_B as points (3,)."""
    oriented = turn < np.pi
    if oriented and not m.planar:
        raise ValueError("poses of spatial arms are not proven here")
    scale = tolerance / turn if oriented else 0.0
    up = np.ascontiguousarray(m.frames[:, :, :3])
    down = np.ascontiguousarray(np.linalg.inv(m.frames)[:, :, :3])
    if oriented:  # the third coordinate is an angle
        up[:, :, 2, 3] = scale * np.arctan2(m.frames[:, :, 1, 0], m.frames[:, :, 0, 0])
        down[:, :, 2, 3] = -up[:, :, 2, 3]
    own = m.bits[np.arange(len(start)), start]
    costs = (m.bits != own[:, None]).sum(axis=2).astype(np.int64)
    size = np.log(m.states).cumsum()
    middle = int(np.abs(size - size[-1] / 2).argmin()) + 1
    first, second = np.arange(middle), np.arange(middle, len(m.states))[::-1]
    for i, k in enumerate(m.states):
        costs[i, k:] = 0
    local = np.linalg.inv(m.base) @ goal
    point = local[:3, 3].copy()
    if oriented:
        point[2] = scale * np.arctan2(local[1, 0], local[0, 0])
    order = np.array(
        [np.argsort(np.where(np.arange(len(c)) < k, c, NONE)) for c, k in zip(costs, m.states, strict=True)]
    )
    lower = Half(first, down[first], m.states[first], costs[first], order[first])
    upper = Half(second, up[second], m.states[second], costs[second], order[second])
    return lower, upper, point, np.zeros(3)


def rows(half: Half, point: Array, depth: int) -> Rows:
    """Returns all rows of a half with at most `depth` switches."""
    counts = np.eye(1, depth + 1, dtype=np.int64)[0]
    for costs, k in zip(half.costs, half.states, strict=True):
        counts = np.convolve(counts, np.bincount(costs[:k], minlength=depth + 1))[: depth + 1]
    n = int(counts.sum())
    result = Rows(np.empty((n, 3)), np.empty(n, dtype=np.int8), np.empty(n, dtype=np.int64))
    result.points[0] = point
    if grow(half, depth, result) != n:
        raise AssertionError("the rows were counted wrongly")
    return result


def table(listed: Rows, radius: float) -> Table:
    low, high = listed.points.min(axis=0), listed.points.max(axis=0)
    extent, side = high - low, 2 * radius
    while np.prod(np.floor(extent / side) + 1) > CELLS:
        side *= 1.25
    shape = np.floor(extent / side).astype(np.int64) + 1
    place = np.minimum(np.floor((listed.points - low) / side).astype(np.int64), shape - 1)
    cell = (place[:, 2] * shape[1] + place[:, 1]) * shape[0] + place[:, 0]
    order = np.lexsort((listed.costs, cell))
    starts = np.zeros(int(shape.prod()) + 1, dtype=np.int64)
    np.cumsum(np.bincount(cell, minlength=len(starts) - 1), out=starts[1:])
    least = np.full(shape[::-1], 127, dtype=np.int8)
    np.minimum.at(least.ravel(), cell, listed.costs)
    for axis in range(3):
        padded = np.pad(least, [(int(k == axis),) * 2 for k in range(3)], constant_values=127)
        least = np.lib.stride_tricks.sliding_window_view(padded, 3, axis).min(axis=-1)
    own = Rows(listed.points[order], listed.costs[order], listed.codes[order])
    return Table(own, starts, low, side, shape, np.ascontiguousarray(least).ravel())


@njit(cache=True, nogil=True, error_model="numpy")
def moved(m: Array, i: int, j: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Returns where motions (m, K, 3, 4) take a point: that of a state of a module."""
    return (
        m[i, j, 0, 0] * x + m[i, j, 0, 1] * y + m[i, j, 0, 2] * z + m[i, j, 0, 3],
        m[i, j, 1, 0] * x + m[i, j, 1, 1] * y + m[i, j, 1, 2] * z + m[i, j, 1, 3],
        m[i, j, 2, 0] * x + m[i, j, 2, 1] * y + m[i, j, 2, 2] * z + m[i, j, 2, 3],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def grow(half: Half, depth: int, out: Rows) -> int:
    """Turns row 0, a point, into all rows with at most `depth` switches; returns their number."""
    out.costs[0], out.codes[0], count = 0, 0, 1
    for i in range(len(half.states)):
        for n in range(count):
            x, y, z = out.points[n]
            cost, code = out.costs[n], out.codes[n] * half.states[i]
            for j in range(half.states[i]):
                more = cost + half.costs[i, j]
                if more <= depth:
                    row = n  # the state without a switch goes on in the row itself
                    if half.costs[i, j] > 0:
                        row = count
                        count += 1
                    out.points[row] = moved(half.motions, i, j, x, y, z)
                    out.costs[row], out.codes[row] = more, code + j
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def write(half: Half, code: int, configuration: Index) -> None:
    for i in range(len(half.states) - 1, -1, -1):
        configuration[half.modules[i]] = code % half.states[i]
        code //= half.states[i]
