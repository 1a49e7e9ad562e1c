"""Configurations of one segment of the arm near a given one, the nearest first to be counted in, with their frames."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.search.frame_rows import Side, compose, invert

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Index32 = NDArray[np.int32]

BINS = 512


@dataclass(frozen=True, eq=False)
class Segment:
    """All configurations of modules first+1 to last that are within a distance of the centre.

    A row differs from its parent row in one module, higher than all that differ in the parent; row 0 is the centre.

    Attributes:
        first: modules below the segment.
        last: modules up to its end.
        parents: row that this one continues, shape (n,).
        modules: module in which it differs from its parent, counted from 0, shape (n,).
        choices: that module's state, shape (n,).
        costs: sum over the segment's modules of what their states cost, shape (n,).
        frames: F_last in F_first, see frame_rows, shape (n, 4) or (n, 12).
        beyond: least distance of a configuration that is left out; infinite if none is.
    """

    first: int
    last: int
    parents: Index32
    modules: Index32
    choices: Index32
    costs: Array
    frames: Array
    beyond: float

    def side(self, rows: Index | None = None) -> Side:
        """Returns the segment, or some of its rows (n,), as kernels take it."""
        chosen = np.arange(len(self.costs)) if rows is None else rows
        costs = self.costs if rows is None else self.costs.take(rows)
        own = self.frames if rows is None else self.frames.take(rows, axis=0)
        return Side(own, costs, chosen, self.first, self.last, self.parents, self.modules, self.choices)

    def write(self, row: int, configuration: Configuration) -> None:
        """Puts a row's states in a configuration (B,) that has the centre's."""
        while row > 0:
            configuration[self.modules[row]] = self.choices[row]
            row = int(self.parents[row])


class Storage:
    """Memory for segments' rows, used again for each: fresh pages would cost more time than what is written to them.

    Args:
        rows: most rows.
        width: numbers of a frame, 4 or 12.
    """

    def __init__(self, rows: int, width: int) -> None:
        self.rows = rows
        self.parents, self.modules, self.choices = (np.empty(rows, dtype=np.int32) for _ in range(3))
        self.lengths, self.costs = np.empty(rows), np.empty(rows)
        self.frames = np.empty((rows, width))

    def claim(self, rows: int | None = None) -> None:
        """Has the system hand out the memory of so many rows, or of all, now, not in the middle of a search."""
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array[:rows].fill(0)


def build_segment(
    motions: Array,
    states: Index,
    storage: Storage,
    centre: Configuration,
    distances: Array,
    costs: Array,
    first: int,
    last: int,
    most: int | None = None,
) -> Segment:
    """Returns the configurations nearest to the centre, whole distances at a time.

    Args:
        motions: frames of every module's states as rows, shape (B * Kmax, 4) or (B * Kmax, 12).
        states: K_i, shape (B,).
        storage: overwritten; the segment lives in it.
        centre: configuration, shape (B,).
        distances: of each module's states from the centre's, which is at 0; shape (B, Kmax).
        costs: of each module's states, shape (B, Kmax).
        first: modules below the segment.
        last: modules up to its end.
        most: configurations besides the centre, at most; as many as the storage holds if absent.
    """
    s = storage
    rows = s.rows if most is None else min(most + 1, s.rows)
    # Distances are counted in eighths of the least, which serves equal weights exactly and others well.
    unit = min(step(distances, states, first, last), 1e300) / 8
    budget = reach(distances, states, first, last, unit, rows - 1)
    while True:
        count, beyond = grow(
            motions,
            states,
            centre,
            distances,
            costs,
            first,
            last,
            budget + 1e-9 * unit,
            rows,
            s.parents,
            s.modules,
            s.choices,
            s.lengths,
            s.costs,
            s.frames,
        )
        if count < rows:
            break
        budget -= unit  # distances that are no multiples of the unit were counted too low
    return Segment(
        first,
        last,
        s.parents[:count],
        s.modules[:count],
        s.choices[:count],
        s.costs[:count],
        s.frames[:count],
        beyond,
    )


@njit("void(i8[::1], i4[::1], i4[::1], i4[::1], i8[:,::1])", cache=True, nogil=True)
def write_rows(rows: Index, parents: Index32, modules: Index32, choices: Index32, configurations: Index) -> None:
    """Puts the states of rows (n,) in configurations (n, B) that have the centre's."""
    for n in range(len(rows)):
        row = rows[n]
        while row > 0:
            configurations[n, modules[row]] = choices[row]
            row = parents[row]


@njit("f8(f8[:,::1], i8[::1], i8, i8)", cache=True, nogil=True)
def step(distances: Array, states: Index, first: int, last: int) -> float:
    """Returns the least positive distance of a single module's state."""
    least = np.inf
    for i in range(first, last):
        for j in range(states[i]):
            if 0 < distances[i, j] < least:
                least = distances[i, j]
    return float(least)


@njit("f8(f8[:,::1], i8[::1], i8, i8, f8, i8)", cache=True, nogil=True)
def reach(distances: Array, states: Index, first: int, last: int, unit: float, most: int) -> float:
    """Returns the greatest distance, in whole units, within which there are about `most` configurations or fewer."""
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


@njit(
    "Tuple((i8, f8))(f8[:,::1], i8[::1], i8[::1], f8[:,::1], f8[:,::1], i8, i8, f8, i8,"
    " i4[::1], i4[::1], i4[::1], f8[::1], f8[::1], f8[:,::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
    fastmath={"contract"},
)
def grow(
    motions: Array,
    states: Index,
    centre: Index,
    distances: Array,
    costs: Array,
    first: int,
    last: int,
    budget: float,
    rows: int,
    parents: Index32,
    modules: Index32,
    choices: Index32,
    lengths: Array,
    prices: Array,
    frames: Array,
) -> tuple[int, float]:
    """Fills the rows; returns their number (all that fit if there are more) and the least distance left out."""
    size, most, width = last - first, distances.shape[1], frames.shape[1]
    # From each module's bottom to the segment's end and back, while the modules between stay at the centre.
    rest, back = np.zeros((size + 1, width)), np.empty((size + 1, width))
    if width == 4:
        rest[size, 2] = 1.0
    else:
        rest[size, 3] = rest[size, 7] = rest[size, 11] = 1.0
    # Each module's states but the centre's, the nearest first: how far, what more they cost, and on to the end.
    ranked, away = np.empty((size, most), dtype=np.int32), np.full((size, most), np.inf)
    dearer, via = np.empty((size, most)), np.empty((size * most, width))
    nearest = np.full(size + 1, np.inf)  # least distance of a change in this module or one after it
    price = 0.0
    for k in range(size - 1, -1, -1):
        i, count = first + k, 0
        for j in range(states[i]):
            if j == centre[i]:
                continue
            at = count
            while at > 0 and away[k, at - 1] > distances[i, j]:
                ranked[k, at], away[k, at] = ranked[k, at - 1], away[k, at - 1]
                at -= 1
            ranked[k, at], away[k, at] = j, distances[i, j]
            count += 1
        for a in range(count):
            j = ranked[k, a]
            dearer[k, a] = costs[i, j] - costs[i, centre[i]]
            compose(motions, i * most + j, rest, k + 1, via, k * most + a)
        compose(motions, i * most + centre[i], rest, k + 1, rest, k)
        nearest[k] = min(nearest[k + 1], away[k, 0])
        price += costs[i, centre[i]]
    for k in range(size + 1):
        invert(rest, k, back, k)
    parents[0], modules[0], choices[0], lengths[0], prices[0] = 0, first - 1, 0, 0.0, price
    for a in range(width):
        frames[0, a] = rest[0, a]
    run, now = np.empty((2, width)), 0
    count, row, beyond = 1, 0, np.inf
    while row < count:
        length, begin = lengths[row], modules[row] + 1 - first
        if length + nearest[begin] > budget:
            beyond = min(beyond, length + nearest[begin])
            row += 1
            continue
        compose(frames, row, back, begin, run, now)
        for k in range(begin, size):
            i = first + k
            for a in range(states[i] - 1):
                total = length + away[k, a]
                if total > budget:
                    beyond = min(beyond, total)
                    break
                if count == rows:
                    return rows, 0.0
                compose(run, now, via, k * most + a, frames, count)
                parents[count], modules[count], choices[count], lengths[count] = row, i, ranked[k, a], total
                prices[count] = prices[row] + dearer[k, a]
                count += 1
            compose(run, now, motions, i * most + centre[i], run, 1 - now)
            now = 1 - now
        row += 1
    return count, beyond
