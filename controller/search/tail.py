"""Exact table of the last few modules: every tip they can reach, so that no pixel decides what the tolerance asks."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Manipulator

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Table = tuple[Array, Array, float, Array, Index, Index, Index]

TABLE = "Tuple((f8[:,::1], f8[:,:,::1], f8, f8[::1], i8[::1], i8[::1], i8[::1]))"  # as kernels take it

MOST_POINTS = 1 << 16
MOST_BRANCHES = 64
POINTS_A_CELL = 2


@dataclass(frozen=True, eq=False)
class Tail:
    """All tips of modules depth+1 to B in frame F_depth, sorted into cells for search by distance.

    Attributes:
        root: number of modules that the densities decide; those from root+1 to depth are all tried over the table.
        depth: number of modules below the table.
        points: tips, in the order of the mixed-radix number their states write, first module most significant, (n, 3).
        turns: their rotations, likewise, shape (n, 3, 3).
        cell: side of a cell.
        corner: least corner of the cells' box, shape (3,).
        shape: cells along x, y, z, shape (3,).
        starts: where each cell's points start in `order`, shape (cells + 1,).
        order: indices into `points`, shape (n,).
    """

    root: int
    depth: int
    points: Array
    turns: Array
    cell: float
    corner: Array
    shape: Index
    starts: Index
    order: Index

    @cached_property
    def table(self) -> Table:
        """The attributes from points on, as kernels take them."""
        return self.points, self.turns, self.cell, self.corner, self.shape, self.starts, self.order


@lru_cache(maxsize=2)  # planning and following share it
def build_tail(manipulator: Manipulator) -> Tail:
    """Returns the table of as many of the last modules as have at most MOST_POINTS configurations, at least of one.

    The modules before them that have together at most MOST_BRANCHES configurations are tried one and all.
    """
    depth = lowest(manipulator.states, len(manipulator.modules) - 1, MOST_POINTS)
    points, turns = np.zeros((1, 3)), np.eye(3)[None]
    for i in reversed(range(depth, len(manipulator.modules))):
        k = manipulator.states[i]
        turned = np.einsum("jab,nb->jna", manipulator.rotations[i, :k], points)
        points = (turned + manipulator.translations[i, :k, None]).reshape(-1, 3)
        turns = (manipulator.rotations[i, :k, None] @ turns).reshape(-1, 3, 3)
    points = np.ascontiguousarray(points)
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    # The greatest of what a line, a plane and a space of points ask, so that flat and thin boxes have few cells too.
    extents = np.sort(size)[::-1]
    cell = max(float(np.prod(extents[:n]) / len(points) * POINTS_A_CELL) ** (1 / n) for n in (1, 2, 3)) or 1.0
    shape = (size / cell).astype(np.int64) + 1
    cells = ((points - low) / cell).astype(np.int64)
    flat = (cells[:, 2] * shape[1] + cells[:, 1]) * shape[0] + cells[:, 0]
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=int(shape.prod())))])
    root = lowest(manipulator.states, depth, MOST_BRANCHES)
    return Tail(
        root,
        depth,
        points,
        np.ascontiguousarray(turns),
        cell,
        low,
        shape,
        starts.astype(np.int64),
        np.argsort(flat, kind="stable"),
    )


def lowest(states: Index, top: int, most: int) -> int:
    """Returns the least i <= top such that modules i+1 to top+1 (or the last) have at most `most` configurations."""
    i, product = top, 1 if top < len(states) - 1 else int(states[-1])
    while i > 0 and product * states[i - 1] <= most:
        i -= 1
        product *= int(states[i])
    return i
