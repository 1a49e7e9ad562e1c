"""Points in cells."""

import numpy as np
import pytest

from controller.search.cells import CELLS, sort_into_cells


@pytest.mark.parametrize("size", [1.0, 1e-290, 1e-313])
@pytest.mark.parametrize("tolerance", [1.0, 1e-3, 1e-300, 8.7e-316, 0.0])
def test_every_point_has_a_cell_however_small_points_and_tolerances_are(size: float, tolerance: float) -> None:
    rows = np.array([[0.0, 0.0], [size, 0.0], [0.0, size], [size / 2, size / 3]])
    starts, near, grid = np.empty(CELLS + 2, dtype=np.int32), np.empty(CELLS, dtype=np.uint8), np.empty(13)
    cells, order, strides = np.empty(4, dtype=np.int32), np.empty(4, dtype=np.int32), np.empty(6, dtype=np.int64)
    given, table = (rows, np.zeros(4), 2, tolerance, 72.0, np.zeros(256)), (starts, near, grid, strides)
    count = sort_into_cells(*given, cells, *table, order, np.empty((4, 2)), np.empty(4))
    assert ((cells >= 0) & (cells < count)).all()
    assert starts[count] == len(rows)
    assert np.isfinite(grid[12])
