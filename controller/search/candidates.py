"""Many cheap configurations for a goal, for those who choose among them."""

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.cells import Cells
from controller.search.found import CLOSE
from controller.search.frame_rows import coordinates, motions
from controller.search.guard import no_part, pairs_of, part
from controller.search.halves import middle
from controller.search.meeting import seen
from controller.search.segment import Storage, build_segment, write_rows
from controller.search.target import Target

Array = NDArray[np.float64]

ROWS = 1 << 12  # of each half


class Candidates:
    """The cheapest configurations near a given one, with the memory to find them.

    Args:
        manipulator: the arm.
        most: how many to find at most.
    """

    def __init__(self, manipulator: Manipulator, most: int) -> None:
        self._m = manipulator
        self._half = middle(manipulator, 0, len(manipulator.modules))
        self._motions = motions(manipulator)
        size, width = coordinates(self._motions), self._motions.shape[1]
        self._lower, self._upper = Storage(ROWS + 1, width), Storage(ROWS + 1, width)
        self._cells, self._asking = Cells(ROWS + 1, size), np.empty((ROWS + 1, width))
        self._pairs, self._costs = np.empty((most, 2), dtype=np.int64), np.empty(most)

    def find(self, target: Target, centre: Configuration, costs: Array) -> tuple[NDArray[np.int64], Array]:
        """Returns configurations (n, B) whose tips are within the tolerances and clear, and what they cost (n,).

        Args:
            target: in frame F_0.
            centre: the configuration that costs nothing, shape (B,).
            costs: of every state of every module, shape (B, Kmax).
        """
        count = len(self._m.modules)
        lower = build_segment(self._motions, self._m.states, self._lower, centre, costs, costs, 0, self._half)
        upper = build_segment(self._motions, self._m.states, self._upper, centre, costs, costs, self._half, count)
        self._cells.fill(upper.frames, upper.costs, target.tolerance * CLOSE)
        asking = self._asking[: len(lower.costs)]
        seen(target.row, lower.frames, asking)
        pairs = None
        if target.guard is not None:
            rows = np.arange(max(len(lower.costs), len(upper.costs)))
            known = np.zeros(len(lower.costs), dtype=np.int8)
            pairs = pairs_of(target.guard, centre, (no_part(), part(lower, rows), part(upper, rows)), known)
        found = self._cells.collect(asking, lower.costs, target.limit, self._pairs, self._costs, pairs)
        configurations = np.tile(centre, (found, 1))
        for segment, rows in zip((lower, upper), self._pairs[:found].T, strict=True):
            chosen = np.ascontiguousarray(rows)
            write_rows(chosen, segment.parents, segment.modules, segment.choices, configurations)
        return configurations, self._costs[:found].copy()
