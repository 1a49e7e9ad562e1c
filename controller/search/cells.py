"""Points in memory that is used again and again, to be asked for what is near."""

import numpy as np
from numpy.typing import NDArray

from controller.search.meeting import CELLS, collect, match, sort_into_cells

Array = NDArray[np.float64]


class Cells:
    """Points sorted into cells."""

    def __init__(self, most: int) -> None:
        """Allocates for at most `most` points."""
        self._starts, self._order = np.empty(CELLS + 1, dtype=np.int32), np.empty(most, dtype=np.int32)
        self._corner, self._shape = np.empty(3), np.empty(3, dtype=np.int64)
        self._points, self._costs, self._cell, self._tolerance = np.empty((0, 3)), np.empty(0), 0.0, 0.0

    def fill(self, points: Array, costs: Array, tolerance: float) -> None:
        """Takes points (n, 3) and their costs (n,)."""
        self._points, self._costs, self._tolerance = points, costs, tolerance
        self._cell, _ = sort_into_cells(points, tolerance, self._starts, self._order, self._corner, self._shape)

    def match(self, asking: Array, costs: Array, best: float, best_square: float) -> tuple[int, int, float, float]:
        """Returns the cheapest pair of an asking row and a point, see meeting.match."""
        return match(
            asking,
            costs,
            self._points,
            self._costs,
            self._starts,
            self._order,
            self._corner,
            self._shape,
            self._cell,
            self._tolerance,
            best,
            best_square,
        )

    def collect(self, asking: Array, costs: Array, pairs: NDArray[np.int64], pair_costs: Array) -> int:
        """Writes the cheapest pairs of asking rows and points, see meeting.collect; returns their number."""
        return collect(
            asking,
            costs,
            self._points,
            self._costs,
            self._starts,
            self._order,
            self._corner,
            self._shape,
            self._cell,
            self._tolerance,
            pairs,
            pair_costs,
        )
