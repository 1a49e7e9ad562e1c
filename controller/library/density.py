"""Density and reach of an arm's tip as arrays."""

from __future__ import annotations

import math
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.library.arguments import Numbers, typed
from hyperbit.controller.library.errors import GoalError
from hyperbit.controller.manipulator.frames import inverse
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.densities import Densities, ball

Array = NDArray[np.float64]


MOST_PIXELS = 50_000_000  # of a map


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

    @typed(GoalError)
    def at(self, points: Numbers) -> Array:
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


class Reach(NamedTuple):
    """A map of the positions that an arm's tip reaches, in pixels parallel to the axes of the world.

    It comes from the arm's `Density`, and has its errors. Obstacles are not respected.

    Attributes:
        reached: whether the tip of at least one configuration is expected within the radius of a pixel's centre, shape
            (ny, nx) for planar arms, (nz, ny, nx) for spatial arms.
        log10_counts: log10 of the number of configurations in each pixel, minus infinity where there are none, same
            shape.
        extent: least x, greatest x, least y, greatest y(, least z, greatest z) of the map, at the edges of its pixels,
            as matplotlib's `imshow` takes them.
        pixel: side of a pixel, in the arm's unit of length.
    """

    reached: NDArray[np.bool_]
    log10_counts: Array
    extent: tuple[float, ...]
    pixel: float

    def __repr__(self) -> str:
        """Returns the pixels and the extent."""
        size = " x ".join(map(str, self.reached.shape[::-1]))
        return f"Reach({size} pixels of {self.pixel:.4g}, {', '.join(f'{edge:.4g}' for edge in self.extent)})"


def reach_of(densities: Densities, manipulator: Manipulator, radius: float) -> Reach:
    """Returns the map of an arm with these densities, with a margin of the radius around it."""
    from scipy.ndimage import distance_transform_edt  # imported here: the first name of the library loads without it

    size, pixel, level = manipulator.dimension, float(densities.pixels[0]), densities.level(0)
    turned, moved = manipulator.base[:size, :size], manipulator.base[:size, 3]
    filled = level >= 0
    centres = (densities.references[0] + pixel * np.argwhere(filled)[:, ::-1])[:, :size]
    places = (centres @ turned.T + moved) / pixel
    first = places.min(axis=0) - math.ceil(radius / pixel) - 1
    places -= first
    shape = np.ceil(places.max(axis=0) + radius / pixel + 2).astype(np.int64)[::-1]
    if (number := math.prod(shape.tolist())) > MOST_PIXELS:
        raise GoalError(
            f"radius: the map would have {number} pixels, up to {MOST_PIXELS} are possible; use a larger pixel"
        )
    counts = np.full(shape, -np.inf)
    for part in product((-0.25, 0.25), repeat=size):  # of a pixel, which may be turned
        index = np.round(places + turned @ part).astype(np.int64)
        np.logaddexp.at(counts, tuple(index[:, ::-1].T), level[filled] - size * math.log(2))
    some = counts > -np.inf
    if radius < pixel:
        reached = counts >= math.log(pixel**size / ball(size, radius))
    else:
        reached = distance_transform_edt(~some) * pixel <= radius
    edges = zip(first * pixel - pixel / 2, (first + counts.shape[::-1]) * pixel - pixel / 2, strict=True)
    return Reach(reached, counts / math.log(10), tuple(float(edge) for pair in edges for edge in pair), pixel)
