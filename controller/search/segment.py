"""Configurations of one segment of the arm near a given one, the nearest first to be counted in, with their frames."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator

Array = NDArray[np.float64]
Index = NDArray[np.int64]

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
        rotations: of frame F_last in frame F_first, shape (n, 3, 3).
        positions: likewise, shape (n, 3).
        beyond: least distance of a configuration that is left out; infinite if none is.
    """

    first: int
    last: int
    parents: Index
    modules: Index
    choices: Index
    costs: Array
    rotations: Array
    positions: Array
    beyond: float

    def write(self, row: int, configuration: Configuration) -> None:
        """Puts a row's states in a configuration (B,) that has the centre's."""
        while row > 0:
            configuration[self.modules[row]] = self.choices[row]
            row = int(self.parents[row])


@njit("void(i8[::1], i8[::1], i8[::1], i8[::1], i8[:,::1])", cache=True, nogil=True)
def write_rows(rows: Index, parents: Index, modules: Index, choices: Index, configurations: Index) -> None:
    """Puts the states of rows (n,) in configurations (n, B) that have the centre's."""
    for n in range(len(rows)):
        row = rows[n]
        while row > 0:
            configurations[n, modules[row]] = choices[row]
            row = parents[row]


class Storage:
    """Memory for segments' rows, used again for each: fresh pages would cost more time than what is written to them.

    Args:
        rows: most rows.
    """

    def __init__(self, rows: int) -> None:
        self.rows = rows
        self.parents, self.modules, self.choices = (np.empty(rows, dtype=np.int64) for _ in range(3))
        self.lengths, self.costs = np.empty(rows), np.empty(rows)
        self.rotations, self.positions = np.empty((rows, 3, 3)), np.empty((rows, 3))
        self.head_rotations, self.head_positions = np.empty((rows, 3, 3)), np.empty((rows, 3))

    def claim(self) -> None:
        """Has the system hand out the memory now, not in the middle of a search."""
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.fill(0)


def build_segment(
    manipulator: Manipulator,
    storage: Storage,
    centre: Configuration,
    distances: Array,
    costs: Array,
    first: int,
    last: int,
) -> Segment:
    """Returns the configurations nearest to the centre, whole distances at a time, as many as the storage holds.

    Args:
        manipulator: the arm.
        storage: overwritten; the segment lives in it.
        centre: configuration, shape (B,).
        distances: of each module's states from the centre's, which is at 0; shape (B, Kmax).
        costs: of each module's states, shape (B, Kmax).
        first: modules below the segment.
        last: modules up to its end.
    """
    m, s = manipulator, storage
    # Distances are counted in eighths of the least, which serves equal weights exactly and others well.
    unit = min(step(distances, m.states, first, last), 1e300) / 8
    budget = reach(distances, m.states, first, last, unit, s.rows - 1)
    while True:
        count, beyond = grow(
            m.rotations,
            m.translations,
            m.states,
            centre,
            distances,
            costs,
            first,
            last,
            budget + 1e-9 * unit,
            s.parents,
            s.modules,
            s.choices,
            s.lengths,
            s.costs,
            s.rotations,
            s.positions,
            s.head_rotations,
            s.head_positions,
        )
        if count < s.rows:
            break
        budget -= unit  # distances that are no multiples of the unit were counted too low
    return Segment(
        first,
        last,
        s.parents[:count],
        s.modules[:count],
        s.choices[:count],
        s.costs[:count],
        s.rotations[:count],
        s.positions[:count],
        beyond,
    )


@njit("void(f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1])", cache=True, nogil=True, inline="always")
def compose(r: Array, b: Array, s: Array, c: Array, out_r: Array, out_b: Array) -> None:
    """Writes the frame (R S, b + R c)."""
    for i in range(3):
        for j in range(3):
            out_r[i, j] = r[i, 0] * s[0, j] + r[i, 1] * s[1, j] + r[i, 2] * s[2, j]
        out_b[i] = b[i] + r[i, 0] * c[0] + r[i, 1] * c[1] + r[i, 2] * c[2]


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
    "Tuple((i8, f8))(f8[:,:,:,::1], f8[:,:,::1], i8[::1], i8[::1], f8[:,::1], f8[:,::1], i8, i8, f8,"
    " i8[::1], i8[::1], i8[::1], f8[::1], f8[::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
    fastmath={"contract"},
)
def grow(
    rotations: Array,
    translations: Array,
    states: Index,
    centre: Index,
    distances: Array,
    costs: Array,
    first: int,
    last: int,
    budget: float,
    parents: Index,
    modules: Index,
    choices: Index,
    lengths: Array,
    prices: Array,
    out_rotations: Array,
    out_positions: Array,
    head_r: Array,
    head_b: Array,
) -> tuple[int, float]:
    """Fills the rows; returns their number (all that fit if there are more) and the least distance left out."""
    rows = len(parents)
    # Frames from each module's top to the segment's end while the modules between stay at the centre.
    rest_r, rest_b = np.empty((last - first + 1, 3, 3)), np.empty((last - first + 1, 3))
    rest_r[-1], rest_b[-1] = np.eye(3), np.zeros(3)
    # Frames of each module's states, and on to the segment's end.
    most = rotations.shape[1]
    via_r, via_b = np.empty((last - first, most, 3, 3)), np.empty((last - first, most, 3))
    price = 0.0
    for i in range(last - 1, first - 1, -1):
        k = i - first
        for j in range(states[i]):
            compose(rotations[i, j], translations[i, j], rest_r[k + 1], rest_b[k + 1], via_r[k, j], via_b[k, j])
        rest_r[k], rest_b[k] = via_r[k, centre[i]], via_b[k, centre[i]]
        price += costs[i, centre[i]]
    # The heads are the frames on top of the module that differs last, kept for rows that may go on.
    head_r[0], head_b[0] = np.eye(3), np.zeros(3)
    parents[0], modules[0], choices[0], lengths[0], prices[0] = 0, first - 1, 0, 0.0, price
    out_rotations[0], out_positions[0] = rest_r[0], rest_b[0]
    nearest = np.full(last - first + 1, np.inf)  # least distance of a change in this module or one after it
    for i in range(last - 1, first - 1, -1):
        nearest[i - first] = min(nearest[i - first + 1], step(distances, states, i, i + 1))
    run_r, run_b, next_r, next_b = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    count, row, beyond = 1, 0, np.inf
    while row < count:
        following = lengths[row] + nearest[modules[row] + 1 - first]
        if following > budget:
            beyond = min(beyond, following)
            row += 1
            continue
        run_r[:], run_b[:] = head_r[row], head_b[row]
        for i in range(modules[row] + 1, last):
            for j in range(states[i]):
                if j == centre[i]:
                    continue
                length = lengths[row] + distances[i, j]
                if length > budget:
                    beyond = min(beyond, length)
                    continue
                if count == rows:
                    return rows, 0.0
                if length + nearest[i + 1 - first] <= budget:
                    compose(run_r, run_b, rotations[i, j], translations[i, j], head_r[count], head_b[count])
                k = i - first
                compose(run_r, run_b, via_r[k, j], via_b[k, j], out_rotations[count], out_positions[count])
                parents[count], modules[count], choices[count], lengths[count] = row, i, j, length
                prices[count] = prices[row] - costs[i, centre[i]] + costs[i, j]
                count += 1
            compose(run_r, run_b, rotations[i, centre[i]], translations[i, centre[i]], next_r, next_b)
            run_r, run_b, next_r, next_b = next_r, next_b, run_r, run_b
        row += 1
    return count, beyond
