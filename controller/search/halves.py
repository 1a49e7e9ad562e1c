"""Both halves of the arm, each with its configurations near a centre, to be met for one goal after another."""

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.cells import Cells
from controller.search.found import CLOSE, Found
from controller.search.segment import Segment, Storage, build_segment, coordinates, motions
from controller.search.target import Target

Array = NDArray[np.float64]

ONE_TARGET = np.zeros(1)


class Halves:
    """Memory for the rows of both halves, used again for each centre.

    Attributes:
        lower: rows of the modules below the cut.
        upper: rows of those above.

    Args:
        manipulator: the arm.
        most: rows of a half, at most.
    """

    lower: Segment
    upper: Segment

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
        self._sorted = 0.0

    def claim(self) -> None:
        """Has the system hand out all memory now, not in the middle of a search with a deadline."""
        for storage in self._storages:
            storage.claim()
        self._cells.claim()
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
        self._key, self._sorted = (), 0.0  # until it is done
        self.lower, self.upper = (
            build_segment(self._motions, self._states, storage, centre, distances, costs, *ends, most)
            for storage, ends in zip(self._storages, ((0, self.cut), (self.cut, self._count)), strict=True)
        )
        self._key = tuple(np.array(part) for part in key)

    def sort(self, tolerance: float) -> None:
        """Sorts the upper rows for a tolerance; does nothing if they are already."""
        if self._sorted != tolerance:
            self._sorted = 0.0
            self._cells.fill(self.upper.frames, self.upper.costs, tolerance)
            self._sorted = tolerance

    def meet(self, target: Target, best: Found) -> Found:
        """Returns the cheapest pair's configuration, or `best`, found before, if none is better."""
        self.sort(target.tolerance * CLOSE)
        _, i, j, cost, square = self._cells.match(
            target.row[None],
            ONE_TARGET,
            self.lower.frames,
            self.lower.costs,
            target.limit,
            target.weight,
            best.cost,
            best.square,
        )
        if i < 0:
            return best
        configuration = self._key[0].astype(np.int64)
        self.lower.write(i, configuration)
        self.upper.write(j, configuration)
        return Found(configuration, cost, square)


def middle(manipulator: Manipulator, first: int, last: int) -> int:
    """Returns the module at which modules first+1 to last are cut into like numbers of configurations."""
    sizes = np.concatenate([[0.0], np.cumsum(np.log2(manipulator.states[first:last]))])
    return first + int(np.argmin(np.abs(sizes - sizes[-1] / 2)))


def rows(manipulator: Manipulator, first: int, last: int, most: int) -> int:
    """Returns how many rows modules first+1 to last need: for `most` configurations, or for all if they are fewer."""
    return int(min(most, np.prod(manipulator.states[first:last].astype(float)))) + 1
