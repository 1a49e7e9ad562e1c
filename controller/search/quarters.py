"""The pairs that two lists leave out: one half of such a pair costs more than was listed, so the other costs little.

For each of those few cheap rows, the dear half is cut in two again, and its quarters meet in the middle.
"""

import time

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.cells import Cells
from controller.search.found import Found
from controller.search.halves import Halves, middle, rows
from controller.search.meeting import seen
from controller.search.segment import Segment, Storage, build_segment, coordinates, motions

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROWS = 1 << 14  # of a quarter
AT_ONCE = 16  # rows checked between two looks at the clock


class Quarters:
    """Memory for the rows of all quarters, used again for each centre.

    Args:
        manipulator: the arm.
        cut: modules in the lower half.
    """

    def __init__(self, manipulator: Manipulator, cut: int) -> None:
        self._states, self._motions = manipulator.states, motions(manipulator)
        count, size = len(self._states), coordinates(self._motions)
        first, second = middle(manipulator, 0, cut), middle(manipulator, cut, count)
        self._ends = ((0, first), (first, cut), (cut, second), (second, count))
        self._storages = [Storage(rows(manipulator, *ends, ROWS), self._motions.shape[1]) for ends in self._ends]
        self._goals = np.empty((self._storages[0].rows, size))
        self._below, self._above = (Cells(self._storages[k].rows, size) for k in (0, 3))
        self._key: tuple[NDArray[np.generic], ...] = ()
        self._sorted = 0.0
        self._segments: list[Segment] = []

    def claim(self) -> None:
        """Has the system hand out all memory now, not in the middle of a search with a deadline."""
        for storage in self._storages:
            storage.claim()
        for cells in (self._below, self._above):
            cells.claim()
        self._goals.fill(0)
        self._key = ()

    def list(self, centre: Configuration, costs: Array) -> None:
        """Lists the cheapest configurations of the quarters; does nothing if they are listed already.

        Args:
            centre: the configuration that costs nothing, shape (B,).
            costs: of each module's states, shape (B, Kmax).
        """
        if self._key and all(map(np.array_equal, (centre, costs), self._key)):
            return
        self._key, self._sorted = (), 0.0  # until it is done
        self._segments = [
            build_segment(self._motions, self._states, storage, centre, costs, costs, *ends)
            for storage, ends in zip(self._storages, self._ends, strict=True)
        ]
        self._key = (centre.copy(), costs.copy())

    def sort(self, tolerance: float) -> None:
        """Sorts the uppermost rows for a tolerance; does nothing if they are already."""
        if self._sorted != tolerance:
            self._sorted = 0.0
            self._above.fill(self._segments[3].frames, self._segments[3].costs, tolerance)
            self._sorted = tolerance

    def check(
        self, goal: Array, tolerance: float, halves: Halves, below: Index, above: Index, best: Found, until: float
    ) -> Found:
        """Returns the best of all pairs that were not listed but may cost less than the best, and the bound proven.

        Args:
            goal: in frame F_0, shape (3,).
            tolerance: of the tip's distance from the goal.
            halves: listed around the same centre.
            below: lower rows to go through with everything above, the cheapest first, shape (n,).
            above: upper rows to go through with everything below, likewise.
            best: found before.
            until: `time.perf_counter()` at which to be done.
        """
        a, b, c, d = self._segments
        lower, upper = halves.lower, halves.upper
        bound = lower.beyond + upper.beyond
        # A lower row with quarters c and d: the goal as seen from the row is seen from c, and is where d must be.
        self.sort(tolerance)
        gap = min(c.beyond, d.beyond)
        for k in range(0, len(below), AT_ONCE):
            chosen = below[k : k + AT_ONCE]
            cost = float(lower.costs[chosen[0]])
            if cost + upper.beyond >= best.cost:
                break
            if time.perf_counter() > until:
                bound = min(bound, cost + upper.beyond)
                break
            bound = min(bound, cost + gap)
            targets = np.zeros((len(chosen), 3))
            seen(goal, np.ascontiguousarray(lower.frames[chosen]), targets)
            t, i, j, found, square = self._above.match(
                targets, lower.costs[chosen], c.frames, c.costs, best.cost, best.square
            )
            if t >= 0:
                best = self._together(found, square, (lower, int(chosen[t])), (c, i), (d, j))
        if not len(above):
            return Found(best.configuration, best.cost, best.square, bound)
        # An upper row with quarters a and b: its tip carried by b is where the goal seen from a must be.
        points = self._goals[: len(a.frames)]
        seen(goal, a.frames, points)
        self._below.fill(points, a.costs, tolerance)
        gap = min(a.beyond, b.beyond)
        for k in range(0, len(above), AT_ONCE):
            chosen = above[k : k + AT_ONCE]
            cost = float(upper.costs[chosen[0]])
            if cost + lower.beyond >= best.cost:
                break
            if time.perf_counter() > until:
                bound = min(bound, cost + lower.beyond)
                break
            bound = min(bound, cost + gap)
            targets = np.zeros((len(chosen), 3))
            targets[:, : points.shape[1]] = upper.positions[chosen]
            t, i, j, found, square = self._below.match(
                targets, upper.costs[chosen], b.frames, b.costs, best.cost, best.square, carried=True
            )
            if t >= 0:
                best = self._together(found, square, (upper, int(chosen[t])), (b, i), (a, j))
        return Found(best.configuration, best.cost, best.square, bound)

    def _together(self, cost: float, square: float, *parts: tuple[Segment, int]) -> Found:
        configuration = self._key[0].astype(np.int64)
        for segment, row in parts:
            segment.write(row, configuration)
        return Found(configuration, cost, square)
