"""Lists of a segment's configurations with their frames: breadth-first from a seed, up to a budget of distance.

A frame is a row of numbers: (x, y, cos, sin) for planar arms, (x, y, z, R row by row) for spatial arms.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int32, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, S1, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Index32 = NDArray[np.int32]

BINS = 512


class Side(NamedTuple):
    """Configurations of one segment of the arm, modules first+1 to last, for kernels."""

    frames: Array  # frames to compare, shape (n, 4) or (n, 12)
    costs: Array  # shape (n,)
    rows: NDArray[np.int64]  # row of each configuration in the segment, shape (n,)
    first: int  # number of modules below the segment
    last: int  # number of modules up to its end
    parents: Index32  # see Segment
    modules: Index32  # see Segment
    choices: Index32  # see Segment


SIDE = named(Side, F2, F1, I1, int64, int64, S1, S1, S1)
NO_ROWS = np.zeros(1, dtype=np.int32)


def fixed(frame: Array) -> Side:
    """Returns the side of a single frame (4,) or (12,) without modules, such as the goal."""
    return Side(frame[None].copy(), np.zeros(1), np.zeros(1, dtype=np.int64), 0, 0, NO_ROWS, NO_ROWS, NO_ROWS)


def motions(manipulator: Manipulator) -> Array:
    """Returns the frames of all states as rows, module by module, shape (B * Kmax, 4) or (B * Kmax, 12)."""
    r, b = manipulator.rotations.reshape(-1, 3, 3), manipulator.translations.reshape(-1, 3)
    parts = (b[:, :2], r[:, :2, 0]) if manipulator.planar else (b, r.reshape(-1, 9))
    return np.concatenate(parts, axis=1)


def coordinates(frames: Array) -> int:
    """Returns the number of coordinates of a position for frames as rows (..., 4 or 12)."""
    return 2 if frames.shape[-1] == 4 else 3


# The next two kernels take array and row number: numba would count references of slices.
@kernel("void(f8[:,::1], i8, f8[:,::1], i8, f8[:,::1], i8)", inline="always")
def compose(a: Array, i: int, b: Array, j: int, out: Array, k: int) -> None:
    """Writes the product of frames a[i] and b[j] to out[k], which must be another row."""
    if out.shape[1] == 4:
        x, y, c, s = a[i, 0], a[i, 1], a[i, 2], a[i, 3]
        out[k, 0] = x + c * b[j, 0] - s * b[j, 1]
        out[k, 1] = y + s * b[j, 0] + c * b[j, 1]
        out[k, 2] = c * b[j, 2] - s * b[j, 3]
        out[k, 3] = s * b[j, 2] + c * b[j, 3]
    else:
        for m in range(3):
            p, q, r = a[i, 3 + 3 * m], a[i, 4 + 3 * m], a[i, 5 + 3 * m]
            out[k, m] = a[i, m] + p * b[j, 0] + q * b[j, 1] + r * b[j, 2]
            for n in range(3):
                out[k, 3 + 3 * m + n] = p * b[j, 3 + n] + q * b[j, 6 + n] + r * b[j, 9 + n]


@kernel("void(f8[:,::1], i8, f8[:,::1], i8)", inline="always")
def invert(a: Array, i: int, out: Array, k: int) -> None:
    """Writes the inverse of frame a[i] to out[k], which must be another row."""
    if out.shape[1] == 4:
        x, y, c, s = a[i, 0], a[i, 1], a[i, 2], a[i, 3]
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = -c * x - s * y, s * x - c * y, c, -s
    else:
        for m in range(3):
            out[k, m] = -a[i, 3 + m] * a[i, 0] - a[i, 6 + m] * a[i, 1] - a[i, 9 + m] * a[i, 2]
            for n in range(3):
                out[k, 3 + 3 * m + n] = a[i, 3 + 3 * n + m]


@kernel("void(f8[:,::1], f8[:,::1], f8[:,::1])", fastmath={"contract"})
def compose_all(frames: Array, frame: Array, out: Array) -> None:
    """Writes the products of frames (n, 4 or 12) and frame[0] to `out`."""
    for n in range(len(frames)):
        compose(frames, n, frame, 0, out, n)


@kernel("void(f8[:,::1])")
def invert_all(frames: Array) -> None:
    """Replaces frames (n, 4 or 12) by their inverses."""
    other = np.empty((1, frames.shape[1]))
    for n in range(len(frames)):
        invert(frames, n, other, 0)
        for a in range(frames.shape[1]):
            frames[n, a] = other[0, a]


@dataclass(frozen=True, eq=False)
class Segment:
    """All configurations of modules first+1 to last within some distance of the seed.

    Row 0 is the seed. Each other row changes one module of its parent row, above all modules changed there.
    """

    first: int  # number of modules below the segment
    last: int  # number of modules up to its end
    parents: Index32  # parent row, shape (n,)
    modules: Index32  # the changed module, counted from 0, shape (n,)
    choices: Index32  # the new state of this module, shape (n,)
    costs: Array  # sum of the costs of the segment's states, shape (n,)
    frames: Array  # F_last in F_first, see segment, shape (n, 4) or (n, 12)
    unexplored: float  # least distance of a configuration that is not listed; infinite if all are

    def side(self, rows: Index | None = None) -> Side:
        """Returns the segment, or some of its rows (n,), for kernels."""
        segment = self.first, self.last, self.parents, self.modules, self.choices
        if rows is None:
            return Side(self.frames, self.costs, np.arange(len(self.costs)), *segment)
        return Side(self.frames.take(rows, axis=0), self.costs.take(rows), rows, *segment)


class Rows(NamedTuple):
    """Memory for the rows of a segment. It is reused: page faults of fresh memory would take longer than the writes."""

    parents: Index32  # see Segment
    modules: Index32  # see Segment
    choices: Index32  # see Segment
    lengths: Array  # distances from the seed, shape (n,)
    costs: Array  # see Segment
    frames: Array  # see Segment

    def claim(self, rows: int | None = None) -> None:
        """Touches the memory of `rows` rows, or of all, so that no search waits for page faults."""
        for array in self:
            array[:rows].fill(0)


class Sets(NamedTuple):
    """The input of a segment."""

    motions: Array  # frames of all states as rows, shape (B * Kmax, 4) or (B * Kmax, 12)
    states: Index  # K_i, shape (B,)
    seed: Configuration  # configuration, shape (B,)
    distances: Array  # distance of each module's states from the seed's state, shape (B, Kmax)
    costs: Array  # cost of each module's states, shape (B, Kmax)


class Ranked(NamedTuple):
    """Scratch: for each module of a segment the states other than the seed's, nearest first."""

    states: Index32  # shape (size, Kmax)
    distances: Array  # distance from the seed's state, infinite after the last, shape (size, Kmax)
    costs: Array  # additional cost, shape (size, Kmax)
    # from the module's bottom to the segment's end, with all modules above at the seed, shape (size * Kmax, 4 or 12)
    frames: Array
    nearest: Array  # least distance of a change of this module or a later one, shape (size + 1,)
    rest: Array  # frames from each module's bottom to the segment's end at the seed, shape (size + 1, 4 or 12)
    back: Array  # their inverses
    price: float  # cost of the seed's states


RANKED = named(Ranked, int32[:, ::1], F2, F2, F2, F1, F2, F2, float64)
ROWS = named(Rows, int32[::1], int32[::1], int32[::1], F1, F1, F2)
SETS = named(Sets, F2, I1, I1, F2, F2)
GROWN: Any = types.Tuple((int64, float64))  # type: ignore[no-untyped-call]


def room(rows: int, width: int) -> Rows:
    """Returns memory for a number of rows whose frames have 4 or 12 numbers."""
    parents, modules, choices = (np.empty(rows, dtype=np.int32) for _ in range(3))
    return Rows(parents, modules, choices, np.empty(rows), np.empty(rows), np.empty((rows, width)))


def build_segment(sets: Sets, rows: Rows, first: int, last: int, most: int | None = None) -> Segment:
    """Returns the configurations of modules first+1 to last nearest to the seed.

    All configurations of one distance are listed, or none of them; beside the seed at most `most`, or as many as fit.
    `rows` is overwritten: the segment refers to this memory.
    """
    size = len(rows.costs) if most is None else min(most + 1, len(rows.costs))
    # Distances are counted in eighths of the least: exact for equal weights, nearly exact for others.
    unit = min(step(sets.distances, sets.states, first, last), 1e300) / 8
    budget = largest_budget(sets.distances, sets.states, first, last, unit, size - 1)
    ranked = rank(sets, first, last)
    while True:
        count, unexplored = grow(sets, ranked, first, budget + 1e-9 * unit, size, rows)
        if count < size:
            break
        budget -= unit  # the counts were too low: distances were rounded down to units
    parents, modules, choices = rows.parents[:count], rows.modules[:count], rows.choices[:count]
    return Segment(first, last, parents, modules, choices, rows.costs[:count], rows.frames[:count], unexplored)


@kernel("f8(f8[:,::1], i8[::1], i8, i8)")
def step(distances: Array, states: Index, first: int, last: int) -> float:
    """Returns the least positive distance of a state of modules first+1 to last."""
    least = np.inf
    for i in range(first, last):
        for j in range(states[i]):
            if 0 < distances[i, j] < least:
                least = distances[i, j]
    return float(least)


@kernel("f8(f8[:,::1], i8[::1], i8, i8, f8, i8)")
def largest_budget(distances: Array, states: Index, first: int, last: int, unit: float, most: int) -> float:
    """Returns the greatest distance, a multiple of `unit`, within which lie about `most` configurations or fewer."""
    counts = np.zeros(BINS)
    counts[0] = 1.0
    for i in range(first, last):
        following = np.zeros(BINS)
        for j in range(states[i]):
            shift = int(distances[i, j] / unit + 1e-6)
            for k in range(BINS - shift):
                following[k + shift] += counts[k]
        counts = following
    total = 0.0
    for k in range(BINS):
        total += counts[k]
        if total > most:
            return max(k - 1, 0) * unit
    return BINS * unit


@kernel([RANKED(SETS, int64, int64)], error_model="numpy", fastmath={"contract"})
def rank(sets: Sets, first: int, last: int) -> Ranked:
    """Ranks the states of modules first+1 to last."""
    motions, states, seed, distances, costs = sets
    size, most, width = last - first, distances.shape[1], motions.shape[1]
    away, nearest = np.full((size, most), np.inf), np.full(size + 1, np.inf)
    rest, back = np.zeros((size + 1, width)), np.empty((size + 1, width))
    for a in range(2 if width == 4 else 3, width, 2 if width == 4 else 4):
        rest[size, a] = 1.0
    order, dearer = np.empty((size, most), dtype=np.int32), np.empty((size, most))
    via, price = np.empty((size * most, width)), 0.0
    for k in range(size - 1, -1, -1):
        i, count = first + k, 0
        for j in range(states[i]):
            if j == seed[i]:
                continue
            at = count
            while at > 0 and away[k, at - 1] > distances[i, j]:
                order[k, at], away[k, at] = order[k, at - 1], away[k, at - 1]
                at -= 1
            order[k, at], away[k, at] = j, distances[i, j]
            count += 1
        for a in range(count):
            j = order[k, a]
            dearer[k, a] = costs[i, j] - costs[i, seed[i]]
            compose(motions, i * most + j, rest, k + 1, via, k * most + a)
        compose(motions, i * most + seed[i], rest, k + 1, rest, k)
        nearest[k] = min(nearest[k + 1], away[k, 0])
        price += costs[i, seed[i]]
    for k in range(size + 1):
        invert(rest, k, back, k)
    return Ranked(order, away, dearer, via, nearest, rest, back, price)


@kernel(
    [GROWN(SETS, RANKED, int64, float64, int64, ROWS)],
    error_model="numpy",
    fastmath={"contract"},
)
def grow(sets: Sets, ranked: Ranked, first: int, budget: float, most_rows: int, rows: Rows) -> tuple[int, float]:
    """Lists the configurations within a budget breadth-first; returns their number and the unexplored distance.

    `ranked` has the states of the segment's modules, from first+1 on.
    """
    motions, states, seed, _, _ = sets
    parents, modules, choices, lengths, prices, frames = rows
    order, away, dearer, via, nearest, rest, back, price = ranked
    (size, most), width = order.shape, frames.shape[1]
    parents[0], modules[0], choices[0], lengths[0] = 0, first - 1, 0, 0.0
    prices[0] = price
    for a in range(width):
        frames[0, a] = rest[0, a]
    run, now = np.empty((2, width)), 0
    count, row, unexplored = 1, 0, np.inf
    while row < count:
        length, begin = lengths[row], modules[row] + 1 - first
        if length + nearest[begin] > budget:
            unexplored = min(unexplored, length + nearest[begin])
            row += 1
            continue
        compose(frames, row, back, begin, run, now)
        for k in range(begin, size):
            i = first + k
            for a in range(states[i] - 1):
                total = length + away[k, a]
                if total > budget:
                    unexplored = min(unexplored, total)
                    break
                if count == most_rows:
                    return count, 0.0
                compose(run, now, via, k * most + a, frames, count)
                parents[count], modules[count], choices[count], lengths[count] = row, i, order[k, a], total
                prices[count] = prices[row] + dearer[k, a]
                count += 1
            compose(run, now, motions, i * most + seed[i], run, 1 - now)
            now = 1 - now
        row += 1
    return count, unexplored
