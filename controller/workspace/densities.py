"""Point densities of all intermediate workspaces of a manipulator (section 2.1)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Densities:
    """The densities of intermediate workspaces W_0 (whole arm) to W_B (tip alone), each an array of pixels.

    Pixel (z, y, x) of level i has its centre at `references[i] + pixels[i] * (x, y, z)` in frame i. Its value is the
    natural logarithm of the number of points in it, at least 0. An empty pixel has minus the distance to the nearest
    pixel with points.
    """

    values: NDArray[np.float32]  # pixels of all levels, level 0 first, float32
    offsets: NDArray[np.int64]  # first pixel of each level in `values`, shape (B+2,)
    shapes: NDArray[np.int64]  # number of pixels along z, y, x, shape (B+1, 3)
    references: NDArray[np.float64]  # centre (x, y, z) of the first pixel of each level, shape (B+1, 3)
    pixels: NDArray[np.float64]  # side of the pixels of each level, shape (B+1,)

    def level(self, i: int) -> NDArray[np.float32]:
        """Returns the values of intermediate workspace i, shape (z, y, x)."""
        return self.values[self.offsets[i] : self.offsets[i + 1]].reshape(self.shapes[i])

    def box(self, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the least and greatest corner (x, y, z) of level i, at the outer edges of its pixels."""
        half = self.pixels[i] / 2
        last = self.references[i] + self.pixels[i] * (self.shapes[i, ::-1] - 1)
        return self.references[i] - half, last + half

    def volume(self, i: int, *, planar: bool) -> float:
        """Returns the area (planar) or volume of one pixel of level i."""
        return float(self.pixels[i] ** (2 if planar else 3))

    def edge(self) -> NDArray[np.float64]:
        """Returns the centres (n, 3) of the pixels on the boundary of W_0."""
        some = np.pad(self.level(0) >= 0, 1)
        inside = some.copy()
        for axis in range(3):
            if self.level(0).shape[axis] > 1:
                inside &= np.roll(some, 1, axis) & np.roll(some, -1, axis)
        z, y, x = np.nonzero((some & ~inside)[1:-1, 1:-1, 1:-1])
        return np.asarray(self.references[0] + self.pixels[0] * np.column_stack((x, y, z)))


def ball(dimension: int, radius: float) -> float:
    """Returns the area of a disc, or the volume of a ball."""
    return math.pi * radius**2 if dimension == 2 else 4 / 3 * math.pi * radius**3
