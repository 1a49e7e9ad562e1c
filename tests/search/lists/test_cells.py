"""Points in cells."""

import numpy as np
import pytest

from hyperbit.controller.search.lists.cells import SortedPoints, grid_of, sort_into_cells


@pytest.mark.parametrize("size", [1.0, 1e-290, 1e-313])
@pytest.mark.parametrize("tolerance", [1.0, 1e-3, 1e-300, 8.7e-316, 0.0])
def test_every_point_has_a_cell_however_small_points_and_tolerances_are(size: float, tolerance: float) -> None:
    rows = np.array([[0.0, 0.0], [size, 0.0], [0.0, size], [size / 2, size / 3]])
    grid, cells = grid_of(rows, 2, tolerance, 72.0), np.empty(4, dtype=np.int32)
    table = SortedPoints(np.empty(grid.cells + 2, dtype=np.int32), cells.copy(), np.empty((4, 2)), np.empty(4))
    sort_into_cells(grid, rows, np.zeros(4), cells, table)
    assert ((cells >= 0) & (cells < grid.cells)).all()
    assert table.starts[grid.cells] == len(rows)
    assert np.isfinite(grid.per)
