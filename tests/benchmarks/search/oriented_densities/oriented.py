"""Point densities with orientation, on R^2 x SO(2) and R^3 x SO(3): how many configurations end in each pixel."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hyperbit.controller.manipulator.frames import Frame
from tests.benchmarks.search.oriented_densities.frame_pixels import write_keys


@dataclass(frozen=True, eq=False)
class OrientedDensities:
    """Intermediate workspaces W_0 (whole arm) to W_B (its tip alone), each a table of the pixels that have points.

    Positions have pixels as in Densities, in a box of each level's own; rotations have `turns[i]` equal arcs if planar,
    else `turns[i]`^3 cells of equal measure (see frame_pixels). A pixel's key counts along z, y, x and rotation, its
    value is the natural logarithm of the number of points in it, never negative. Each pixel takes 12 bytes.

    Attributes:
        keys: all levels' pixels one after the other, base level first, increasing within a level.
        values: one for each key, float32.
        offsets: where each level starts, shape (B+2,).
        shapes: pixels along z, y, x, shape (B+1, 3).
        references: centre of each level's first pixel, x, y, z, shape (B+1, 3).
        pixels: side of each level's pixels, shape (B+1,).
        turns: cells of a full turn (planar) or along the cube of rotations, shape (B+1,).
        planar: whether the arm stays in the plane.
    """

    keys: NDArray[np.int64]
    values: NDArray[np.float32]
    offsets: NDArray[np.int64]
    shapes: NDArray[np.int64]
    references: NDArray[np.float64]
    pixels: NDArray[np.float64]
    turns: NDArray[np.int64]
    planar: bool

    def level(self, i: int) -> NDArray[np.float32]:
        """Returns the values of those pixels of intermediate workspace i that have points, shape (n,)."""
        return self.values[self.offsets[i] : self.offsets[i + 1]]

    def cells(self, i: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Returns the position at the centre (n, 3) and the cell of rotation (n,) of each of these pixels.

        Cell k of a planar arm is centred at the angle 2 pi k / turns.
        """
        own = self.keys[self.offsets[i] : self.offsets[i + 1]]
        rest, cell = np.divmod(own, self.turns[i] ** (1 if self.planar else 3))
        z, y, x = np.unravel_index(rest, tuple(self.shapes[i]))
        return self.references[i] + self.pixels[i] * np.column_stack((x, y, z)), cell

    def keys_of(self, i: int, tips: Frame) -> NDArray[np.int64]:
        """Returns the keys of the pixels that frames (n, 4, 4), seen from frame i, lie in; -1 outside of the box."""
        compact = np.hstack((tips[:, :3, 3], Rotation.from_matrix(tips[:, :3, :3]).as_quat()))
        found = np.empty(len(tips), dtype=np.int64)
        write_keys(compact, self.references[i], self.pixels[i], self.shapes[i], self.planar, self.turns[i], found)
        return found

    def at(self, i: int, tips: Frame) -> NDArray[np.float32]:
        """Returns the values of the pixels that frames (n, 4, 4) in frame i lie in; -inf where no points are."""
        wanted, own = self.keys_of(i, tips), self.keys[self.offsets[i] : self.offsets[i + 1]]
        place = np.minimum(np.searchsorted(own, wanted), len(own) - 1)
        return np.where(own[place] == wanted, self.level(i)[place], np.float32(-np.inf))

    def box(self, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the least and greatest corner (x, y, z) of level i, outer edges of its pixels."""
        half = self.pixels[i] / 2
        last = self.references[i] + self.pixels[i] * (self.shapes[i, ::-1] - 1)
        return self.references[i] - half, last + half

    def volume(self, i: int) -> float:
        """Returns the measure of one pixel of level i: its area times its arc, or its volume times its share of SO(3).

        SO(3) as a whole measures 8 pi^2, so that a small rotation about one axis measures its angle.
        """
        if self.planar:
            return float(self.pixels[i] ** 2 * 2 * math.pi / self.turns[i])
        return float(self.pixels[i] ** 3 * 8 * math.pi**2 / self.turns[i] ** 3)
