"""The pairs that two lists leave out: one half of such a pair costs more than was listed, so the other costs little.

For each of those few cheap rows, the dear half is cut in two again, and its quarters meet in the middle.
"""

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.cells import Cells
from controller.search.found import CLOSE, Found
from controller.search.frame_rows import coordinates, motions
from controller.search.guard import NOTHING_KNOWN, pairs_of, part
from controller.search.halves import Halves, middle, rows
from controller.search.meeting import seen
from controller.search.segment import Segment, Storage, build_segment
from controller.search.target import Target

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROWS = 1 << 14  # of a quarter
AT_ONCE = 4  # rows checked between two looks at the clock


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
        self._goals = np.empty((self._storages[0].rows, self._motions.shape[1]))
        self._below, self._above = (Cells(self._storages[k].rows, size) for k in (0, 3))
        self._key: tuple[NDArray[np.generic], ...] = ()
        self._sorted: tuple[float, ...] = ()
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
        self._key, self._sorted = (), ()  # until it is done
        self._segments = [
            build_segment(self._motions, self._states, storage, centre, costs, costs, *ends)
            for storage, ends in zip(self._storages, self._ends, strict=True)
        ]
        self._key = (centre.copy(), costs.copy())

    def sort(self, tolerance: float, limit: float = np.inf) -> None:
        """Sorts the uppermost rows for tolerances, see Cells.fill; does nothing if they are already."""
        if self._sorted != (tolerance, limit):
            self._sorted = ()
            self._above.fill(self._segments[3].frames, self._segments[3].costs, tolerance, limit)
            self._sorted = (tolerance, limit)

    def check(self, target: Target, halves: Halves, below: Index, above: Index, best: Found, until: float) -> Found:
        """Returns the best of all pairs that were not listed but may cost less than the best, and the bound proven.

        Args:
            target: in frame F_0.
            halves: listed around the same centre.
            below: lower rows to go through with everything above, the cheapest first, shape (n,).
            above: upper rows to go through with everything below, likewise.
            best: found before.
            until: `time.perf_counter()` at which to be done.
        """
        a, b, c, d = self._segments
        lower, upper = halves.lower, halves.upper
        best = Found(best.configuration, best.cost, best.square, lower.beyond + upper.beyond)
        # A lower row with quarters c and d: the goal as seen from the row is seen from c, and is where d must be.
        self.sort(target.tolerance * CLOSE, target.limit)
        frames = np.empty((len(below), lower.frames.shape[1]))
        seen(target.row, np.ascontiguousarray(lower.frames[below]), frames)
        best = self._through(target, lower, below, frames, upper.beyond, (c, d), self._above, best, until)
        # An upper row with quarters a and b: its tip carried by b is where the goal seen from a must be.
        goals = self._goals[: len(a.frames)]
        seen(target.row, a.frames, goals)
        self._below.fill(goals, a.costs, target.tolerance * CLOSE, target.limit)
        frames = np.ascontiguousarray(upper.frames[above])
        return self._through(target, upper, above, frames, lower.beyond, (b, a), self._below, best, until, carried=True)

    def _through(
        self,
        target: Target,
        half: Segment,
        chosen: Index,
        frames: Array,
        beyond: float,
        quarters: tuple[Segment, Segment],
        cells: Cells,
        best: Found,
        until: float,
        *,
        carried: bool = False,
    ) -> Found:
        """Returns the best after rows of one half, and the bound proven.

        Args:
            target: in frame F_0.
            half: whose rows they are.
            chosen: the rows, the cheapest first, shape (n,).
            frames: targets of the quarter that asks, for each row, shape (n, 4) or (n, 12).
            beyond: what the other half costs at least, or else the pair was listed.
            quarters: of the other half, the one that asks and the one in the cells.
            cells: to be asked.
            best: found before, with the bound so far.
            until: `time.perf_counter()` at which to be done.
            carried: whether targets are carried by the asking quarter's frames, or seen from them.
        """
        asking, asked = quarters
        gap = min(asking.beyond, asked.beyond)
        rows = np.arange(0 if target.guard is None else max(len(asking.costs), len(asked.costs)))
        for start in range(0, len(chosen), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            cost = float(half.costs[chosen[start]])
            if cost + beyond >= best.cost:
                break
            if time.perf_counter() > until:
                return replace(best, bound=min(best.bound, cost + beyond))
            best = replace(best, bound=min(best.bound, cost + gap))
            pairs = None
            if target.guard is not None:
                parts = part(half, chosen[some]), part(asking, rows), part(asked, rows)
                pairs = pairs_of(target.guard, self._key[0].astype(np.int64), parts, NOTHING_KNOWN)
            t, i, j, found, square = cells.match(
                frames[some],
                half.costs[chosen[some]],
                asking.frames,
                asking.costs,
                target.weight,
                best.cost,
                best.square,
                pairs,
                carried=carried,
            )
            if t >= 0:
                configuration = self._key[0].astype(np.int64)
                for segment, row in ((half, int(chosen[start + t])), (asking, i), (asked, j)):
                    segment.write(row, configuration)
                best = Found(configuration, found, square, best.bound)
        return best
