"""Both halves of the arm, each with its configurations near a centre, to be met for one goal after another."""

import time
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.cells import Cells
from controller.search.found import CLOSE, Found
from controller.search.frame_rows import coordinates, motions
from controller.search.guard import Guard, Pairs, no_part, pairs_of, part
from controller.search.segment import Segment, Storage, build_segment
from controller.search.target import Target

Array = NDArray[np.float64]

ONE_TARGET = np.zeros(1)
AT_ONCE = 1 << 15  # lower rows that ask between two looks at the clock
GUARDED = 1 << 12  # the same where pairs are looked at for what they touch


class Halves:
    """Memory for the rows of both halves, used again for each centre.

    Attributes:
        lower: rows of the modules below the cut.
        upper: rows of those above.
        unasked: least cost of the lower rows that the last meeting had no time for; infinite if all have met.

    Args:
        manipulator: the arm.
        most: rows of a half, at most.
    """

    lower: Segment
    upper: Segment
    unasked: float = np.inf

    def __init__(self, manipulator: Manipulator, most: int) -> None:
        self._states, self._motions = manipulator.states, motions(manipulator)
        self._count = len(self._states)
        self.cut = middle(manipulator, 0, self._count)
        self._storages = [
            Storage(rows(manipulator, *ends, most), self._motions.shape[1])
            for ends in ((0, self.cut), (self.cut, self._count))
        ]
        self._cells = Cells(self._storages[1].rows, coordinates(self._motions))
        self._key: tuple[NDArray[np.generic], ...] = ()
        self._sorted: tuple[float, ...] = ()
        self._known = np.zeros(self._storages[0].rows, dtype=np.int8)  # of the lower rows, whether they touch
        self._guard: Guard = None

    def claim(self, most: int | None = None) -> None:
        """Has the system hand out the memory of so many rows, or of all, before a search with a deadline."""
        for storage in self._storages:
            storage.claim(most)
        self._cells.claim(most)
        self._key = ()

    def list(self, centre: Configuration, distances: Array, costs: Array, most: int | None = None) -> None:
        """Lists the configurations nearest to the centre; does nothing if they are listed already.

        Args:
            centre: shape (B,).
            distances: of each module's states from the centre's, shape (B, Kmax).
            costs: of each module's states, shape (B, Kmax).
            most: rows of a half, at most; absent: as many as there is room for.
        """
        key = (centre, distances, costs, np.array([0 if most is None else most]))
        if self._key and all(map(np.array_equal, key, self._key)):
            return
        self._key, self._sorted, self._guard = (), (), None  # until it is done
        self.lower, self.upper = (
            build_segment(self._motions, self._states, storage, centre, distances, costs, *ends, most)
            for storage, ends in zip(self._storages, ((0, self.cut), (self.cut, self._count)), strict=True)
        )
        self._key = tuple(np.array(part) for part in key)

    def sort(self, tolerance: float, limit: float = np.inf) -> None:
        """Sorts the upper rows for tolerances, see Cells.fill; does nothing if they are already."""
        if self._sorted != (tolerance, limit):
            self._sorted = ()
            self._cells.fill(self.upper.frames, self.upper.costs, tolerance, limit)
            self._sorted = (tolerance, limit)

    def meet(self, target: Target, best: Found, until: float = np.inf) -> Found:
        """Returns the cheapest pair's configuration, or `best`, found before, if none is better.

        Args:
            target: in frame F_0.
            best: found before.
            until: `time.perf_counter()` at which no more pairs are looked at.
        """
        self.sort(target.tolerance * CLOSE, target.limit)
        self.unasked, lower = np.inf, self.lower
        at_once = AT_ONCE if target.guard is None else GUARDED
        for start in range(0, len(lower.costs), at_once):
            if start > 0 and time.perf_counter() > until:
                self.unasked = float(lower.costs[start:].min())
                break
            asking = slice(start, start + at_once)
            _, i, j, cost, square = self._cells.match(
                target.row[None],
                ONE_TARGET,
                lower.frames[asking],
                lower.costs[asking],
                target.weight,
                best.cost,
                best.square,
                self._pairs(target.guard, asking),
            )
            if i >= 0:
                configuration = self._key[0].astype(np.int64)
                lower.write(start + i, configuration)
                self.upper.write(j, configuration)
                best = Found(configuration, cost, square)
        return best

    def _pairs(self, guard: Guard, asking: slice) -> Pairs:
        """Returns what kernels need to see whether pairs touch."""
        if guard is None:
            return None
        if self._guard is not guard:
            self._guard = guard
            self._known.fill(0)
        count = len(self.lower.costs)
        parts = no_part(), part(self.lower, self._rows[:count][asking]), part(self.upper, self._rows)
        return pairs_of(guard, self._key[0].astype(np.int64), parts, self._known[:count][asking])

    @cached_property
    def _rows(self) -> NDArray[np.int64]:
        """The numbers of rows."""
        return np.arange(max(storage.rows for storage in self._storages))


def middle(manipulator: Manipulator, first: int, last: int) -> int:
    """Returns the module at which modules first+1 to last are cut into like numbers of configurations."""
    sizes = np.concatenate([[0.0], np.cumsum(np.log2(manipulator.states[first:last]))])
    return first + int(np.argmin(np.abs(sizes - sizes[-1] / 2)))


def rows(manipulator: Manipulator, first: int, last: int, most: int) -> int:
    """Returns how many rows modules first+1 to last need: for `most` configurations, or for all if they are fewer."""
    return int(min(most, np.prod(manipulator.states[first:last].astype(float)))) + 1
