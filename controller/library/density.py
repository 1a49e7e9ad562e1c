"""The density of an arm's tip positions as arrays."""

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.library.errors import GoalError
from hyperbit.controller.manipulator.frames import inverse
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.densities import Densities

Array = NDArray[np.float64]


class Density:
    """Number of configurations by tip position: the workspace density of Ebert-Uphoff and Chirikjian 1996.

    The pixels are parallel to the axes of the base frame. They come from the Mapping Algorithm, so counts are
    approximate.

    Attributes:
        log_counts: natural logarithm of the number of configurations in each pixel, minus infinity where there are
            none, shape (ny, nx) for planar arms, (nz, ny, nx) for spatial arms.
        origin: centre of the first pixel in the base frame, shape (dimension,): x, y(, z).
        pixel: side of a pixel, in the arm's unit of length.
    """

    def __init__(self, densities: Densities, manipulator: Manipulator) -> None:
        """Copies level 0 of an arm's densities."""
        self._dimension = manipulator.dimension
        level = densities.level(0)
        values = level[0] if manipulator.planar else level
        self.log_counts: Array = np.where(values >= 0, values, -np.inf).astype(np.float64)
        self.origin: Array = densities.references[0, : self._dimension].copy()
        self.pixel = float(densities.pixels[0])
        self._to_base = inverse(manipulator.base)

    def __repr__(self) -> str:
        """Returns the number of configurations and the pixels."""
        size = " x ".join(map(str, self.log_counts.shape[::-1]))
        return f"Density(10^{self.total / np.log(10):.1f} configurations, {size} pixels of {self.pixel:.4g})"

    @cached_property
    def total(self) -> float:
        """Natural logarithm of the number of all configurations."""
        return float(np.logaddexp.reduce(self.log_counts, axis=None))

    def at(self, points: ArrayLike) -> Array:
        """Returns configurations per unit of area or volume at points of the world.

        Args:
            points: shape (n, dimension), or (dimension,) for a single point.

        Returns:
            Shape (n,), or () for a single point; 0 outside the workspace.

        Raises:
            GoalError: the points have a wrong number of coordinates.
        """
        given = np.asarray(points, dtype=float)
        if given.ndim not in (1, 2) or given.shape[-1] != self._dimension:
            raise GoalError(f"points of shape (n, {self._dimension}) are needed, got shape {given.shape}")
        size = self._dimension
        local = given @ self._to_base[:size, :size].T + self._to_base[:size, 3]
        index = np.round((local - self.origin) / self.pixel)[..., ::-1]
        inside = np.asarray(((index >= 0) & (index < self.log_counts.shape)).all(axis=-1))
        chosen = np.where(inside[..., None], index, 0).astype(np.int64)
        logs = self.log_counts[tuple(np.moveaxis(chosen, -1, 0))]
        return np.asarray(np.where(inside, np.exp(np.minimum(logs, 700.0)), 0.0) / self.pixel**size)
