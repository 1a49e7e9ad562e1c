"""Points in memory that is used again and again, to be asked for what is near."""

import numpy as np
from numpy.typing import NDArray

from controller.search.meeting import CELLS, collect, match, put_into_cells, sort_into_cells

Array = NDArray[np.float64]


class Cells:
    """Points in the order of the cells they lie in.

    Args:
        most: room for so many points.
        size: their coordinates, 2 or 3.
    """

    def __init__(self, most: int, size: int) -> None:
        self._starts, self._cells = np.empty(CELLS + 1, dtype=np.int32), np.empty(most, dtype=np.int32)
        self._order, self._points, self._prices = np.empty(most, dtype=np.int32), np.empty((most, size)), np.empty(most)
        self._grid, self._tolerance = np.empty(7), 0.0
        self._rows = np.empty((0, size))

    def claim(self) -> None:
        """Has the system hand out the memory now, not in the middle of a search."""
        for array in (self._starts, self._cells, self._order, self._points, self._prices):
            array.fill(0)

    def fill(self, rows: Array, costs: Array, tolerance: float) -> None:
        """Takes points, the first numbers of rows (n, ...), and their costs (n,).

        The rows must stay as they are where rotations will be asked for: they are frames then, (n, 4) or (n, 12).
        """
        n, self._rows, self._tolerance = len(rows), rows, tolerance
        sort_into_cells(rows, self._points.shape[1], tolerance, self._starts, self._cells, self._grid)
        put_into_cells(rows, costs, self._starts, self._cells, self._order, self._points[:n], self._prices[:n])

    def match(
        self,
        targets: Array,
        target_costs: Array,
        frames: Array,
        frame_costs: Array,
        limit: float,
        weight: float,
        best: float,
        best_square: float,
        *,
        carried: bool = False,
    ) -> tuple[int, int, int, float, float]:
        """Returns the best target, frame and row, see meeting.match; targets are seen from the frames, or carried."""
        n = len(self._rows)
        return match(
            targets,
            target_costs,
            frames,
            frame_costs,
            not carried,
            self._points[:n],
            self._prices[:n],
            self._starts,
            self._order,
            self._grid,
            self._rows,
            self._tolerance,
            limit,
            weight,
            best,
            best_square,
        )

    def collect(self, asking: Array, costs: Array, limit: float, pairs: NDArray[np.int64], pair_costs: Array) -> int:
        """Writes the cheapest pairs of asking frames and rows, see meeting.collect; returns their number."""
        n = len(self._rows)
        return collect(
            asking,
            costs,
            self._points[:n],
            self._prices[:n],
            self._starts,
            self._order,
            self._grid,
            self._rows,
            self._tolerance,
            limit,
            pairs,
            pair_costs,
        )
