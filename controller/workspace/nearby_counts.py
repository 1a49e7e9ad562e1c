"""Number of configurations whose tip is within a radius of a position.

The tips of the last modules are listed and sorted into cells. The modules before them are compared one by one (two
halves, as in meet-in-the-middle), or drawn along the densities if they have too many configurations.
"""

import math
from typing import Literal, NamedTuple

import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, named
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import coarsened, grid
from hyperbit.controller.workspace.orientations import OrientationSamples, draw, frames_of, listed_from
from hyperbit.controller.workspace.reachability import levels_of, tables_of

Array = NDArray[np.float64]
CountMethod = Literal["listing", "halves", "draws"]

LISTED = 1 << 21  # most tips of the last modules to list
LISTED_FOR_DRAWS = 1 << 16  # the same for drawn modules before: each draw compares many
COMPARED = 1 << 15  # most configurations of the modules before, to compare one by one
DRAWS = 512  # draws for a position if the modules before are drawn
AT_ONCE = 1 << 19  # positions in frames of the listed modules, at once in memory


class TipCells(NamedTuple):
    """Tips of the last modules in the frame below them, sorted by cubic cells."""

    tips: Array  # shape (n, 3)
    offsets: NDArray[np.int64]  # first tip of each cell, x fastest, shape (cells+1,)
    shape: NDArray[np.int64]  # number of cells along z, y, x, shape (3,)
    reference: Array  # centre (x, y, z) of the first cell, shape (3,)
    side: float  # of a cell, at least the radius


CELLS = named(TipCells, F2, I1, I1, F1, float64)


class NearbyCounts:
    """Counts the configurations whose tip is within a radius of positions.

    Attributes:
        method: "listing": all tips are listed. "halves": the last modules are listed and the others are compared one by
            one; both counts are exact. "draws": the others are drawn; the expected count is exact.
        compared: configurations of the modules before the listed ones that are compared or drawn for a position.
        tests: number of distances computed so far.
    """

    def __init__(self, manipulator: Manipulator, densities: Densities, radius: float) -> None:
        self._radius, self.tests = radius, 0
        depth = listed_from(manipulator, LISTED)
        before = math.prod(manipulator.states[:depth].tolist())
        self.method: CountMethod = "listing" if before == 1 else "halves" if before <= COMPARED else "draws"
        self._depth = listed_from(manipulator, LISTED_FOR_DRAWS) if self.method == "draws" else depth
        self._cells = sorted_tips(last_tips(manipulator, self._depth), radius, manipulator.dimension)
        self.compared = DRAWS if self.method == "draws" else before
        if self.method == "draws":
            self._arm, self._levels = tables_of(manipulator), levels_of(densities)
        else:
            self._frames = frames_of(manipulator, self._depth)

    def logs(self, points: Array, random: np.random.Generator) -> Array:
        """Returns ln of the number of configurations near points (n, 3) of frame F_0; minus infinity: none found.

        `random` draws states of modules.
        """
        with np.errstate(divide="ignore"):
            if self.method == "draws":
                return np.array([self._drawn(point, random) for point in np.ascontiguousarray(points)])
            size = max(AT_ONCE // self.compared, 1)
            return np.concatenate([np.log(self._exact(points[k : k + size])) for k in range(0, len(points), size)])

    def _exact(self, points: Array) -> Array:
        """Returns the numbers (n,) of configurations near points (n, 3)."""
        turns, places = self._frames[:, :3, :3], self._frames[:, :3, 3]
        seen = np.einsum("mba,nmb->nma", turns, points[:, None] - places, optimize=True)
        counts = np.empty(seen.shape[0] * seen.shape[1])
        self.tests += count_near(self._cells, np.ascontiguousarray(seen.reshape(-1, 3)), self._radius, counts)
        return np.asarray(counts.reshape(len(points), -1).sum(axis=1))

    def _drawn(self, point: Array, random: np.random.Generator) -> float:
        """Returns ln of the estimated number of configurations near a point (3,)."""
        samples = OrientationSamples(np.empty((DRAWS, 3, 3)), np.empty((DRAWS, 3)), np.empty(DRAWS))
        draw(point, self._arm, self._levels, random.random((DRAWS, self._depth)), samples)
        counts = np.empty(DRAWS)
        self.tests += count_near(self._cells, samples.points, self._radius, counts)
        return float(np.logaddexp.reduce(samples.logs + np.log(counts))) - math.log(DRAWS)


def last_tips(manipulator: Manipulator, depth: int) -> Array:
    """Returns all tips (n, 3) of the modules after the first `depth`, in the frame of the module before them."""
    tips = np.zeros((1, 3))
    for module in reversed(manipulator.modules[depth:]):
        tips = np.concatenate([tips @ frame[:3, :3].T + frame[:3, 3] for frame in module.frames])
    return tips


def sorted_tips(tips: Array, radius: float, dimension: int) -> TipCells:
    """Returns tips (n, 3) in at most about two cells a tip; no cell is smaller than the radius."""
    low, high = tips.min(axis=0), tips.max(axis=0)
    side = coarsened(radius, low, high, 2 * len(tips) + 64, dimension)
    shape, reference = grid(low, high, side)
    z, y, x = np.clip(np.round((tips - reference) / side), 0, np.array(shape[::-1]) - 1).astype(np.int64).T[::-1]
    cells = (z * shape[1] + y) * shape[2] + x
    offsets = np.concatenate(([0], np.cumsum(np.bincount(cells, minlength=math.prod(shape)))))
    return TipCells(tips[np.argsort(cells)], offsets.astype(np.int64), np.array(shape), reference, side)


@kernel(int64(CELLS, F2, float64, F1), error_model="numpy")
def count_near(cells: TipCells, points: Array, radius: float, counts: Array) -> int:
    """Writes the number of tips within a radius of each point (n, 3) to `counts` (n,); returns the number of tests."""
    tips, offsets, shape, reference, side = cells
    height, width = shape[1], shape[2]
    square, tests, low, high = radius * radius, 0, np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(len(points)):
        total, outside = 0, False
        for a in range(3):
            place, end = points[n, a] - reference[a], shape[2 - a] - 1
            if place < -radius - side or place > radius + side * (end + 1):
                outside = True
                break
            low[a] = max(int64(np.floor((place - radius) / side + 0.499)), 0)
            high[a] = min(int64(np.floor((place + radius) / side + 0.501)), end)
        if not outside:
            x, y, z = points[n]
            for k in range(low[2], high[2] + 1):
                for j in range(low[1], high[1] + 1):
                    row = (k * height + j) * width
                    first, last = offsets[row + low[0]], offsets[row + high[0] + 1]
                    dx = max(abs(reference[0] + low[0] * side - x), abs(reference[0] + high[0] * side - x)) + side / 2
                    dy, dz = abs(reference[1] + j * side - y) + side / 2, abs(reference[2] + k * side - z) + side / 2
                    if dx * dx + dy * dy + dz * dz <= square:  # all cells of the row are inside
                        total += last - first
                        continue
                    tests += last - first
                    for t in range(first, last):
                        dx, dy, dz = tips[t, 0] - x, tips[t, 1] - y, tips[t, 2] - z
                        if dx * dx + dy * dy + dz * dz <= square:
                            total += 1
        counts[n] = total
    return tests
