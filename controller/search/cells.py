"""Points in memory that is used again and again, to be asked for what is near."""

import numpy as np
from numpy.typing import NDArray

from controller.search.guard import Pairs
from controller.search.meeting import collect, match
from controller.search.pose_meeting import match_poses, write_points
from controller.search.sorting import CELLS, Sorted, put_into_cells, sort_into_cells

Array = NDArray[np.float64]


class Cells:
    """Points in the order of the cells they lie in.

    Args:
        most: room for so many points.
        size: coordinates of a position, 2 or 3.
    """

    def __init__(self, most: int, size: int) -> None:
        self._starts, self._cells = np.empty(CELLS + 1, dtype=np.int32), np.empty(most, dtype=np.int32)
        self._order, self._prices = np.empty(most, dtype=np.int32), np.empty(most)
        self._size, self._whole = size, 3 if size == 2 else 6
        self._room, self._unsorted = np.empty(most * self._whole), np.empty(most * self._whole)
        self._grid, self._tolerance, self._limit = np.empty(13), 0.0, np.inf
        self._sorted: Sorted

    def claim(self, most: int | None = None) -> None:
        """Has the system hand out the memory for so many points, or for all, now, not in the middle of a search."""
        self._starts.fill(0)
        for array in (self._cells, self._order, self._prices):
            array[:most].fill(0)
        for array in (self._room, self._unsorted):
            array[: most and most * self._whole].fill(0)

    def fill(self, rows: Array, costs: Array, tolerance: float, limit: float = np.inf) -> None:
        """Takes points, the first numbers of rows (n, ...), and their costs (n,).

        Args:
            rows: frames, (n, 4) or (n, 12), where rotations will be asked for; they must stay as they are then.
            costs: shape (n,).
            tolerance: of the distances to be asked for.
            limit: of the rotations' squared chord, see Target; infinite where any will do.
        """
        n, self._tolerance, self._limit = len(rows), tolerance, limit
        size, points = self._size, rows
        if limit < np.inf:
            size = self._whole
            points = self._unsorted[: n * size].reshape(n, size)
            write_points(rows, tolerance / np.sqrt(limit), points)
        own, prices = self._room[: n * size].reshape(n, size), self._prices[:n]
        sort_into_cells(points, size, tolerance, self._starts, self._cells, self._grid)
        put_into_cells(points, costs, self._starts, self._cells, self._order, own, prices)
        self._sorted = own, prices, self._starts, self._order, self._grid, rows

    def match(
        self,
        targets: Array,
        target_costs: Array,
        frames: Array,
        frame_costs: Array,
        weight: float,
        best: float,
        best_square: float,
        pairs: Pairs,
        *,
        carried: bool = False,
    ) -> tuple[int, int, int, float, float]:
        """Returns the best target, frame and row, see meeting.match; targets are seen from the frames, or carried."""
        if self._limit < np.inf:
            return match_poses(
                targets,
                target_costs,
                frames,
                frame_costs,
                not carried,
                self._sorted,
                self._tolerance,
                self._limit,
                weight,
                best,
                best_square,
                pairs,
            )
        return match(
            targets,
            target_costs,
            frames,
            frame_costs,
            not carried,
            self._sorted,
            self._tolerance,
            weight,
            best,
            best_square,
            pairs,
        )

    def collect(
        self, asking: Array, costs: Array, limit: float, found: NDArray[np.int64], found_costs: Array, pairs: Pairs
    ) -> int:
        """Writes the cheapest pairs of asking frames and rows, see meeting.collect; returns their number."""
        return collect(asking, costs, self._sorted, self._tolerance, limit, found, found_costs, pairs)
