"""The Mapping Algorithm (section 3.1.1): point densities of all intermediate workspaces, from the tip to the base.

W_{i-1} is the superposition of W_i moved by each configuration (R, b) of module i. A bound on the pixels of a level
makes time and memory linear in the number of modules.

Each pixel carries the centroid of its points, and the centroid is moved. Moved pixel centres would be rounded at each
module. If pixels are larger than a module's step, a long arm would then not reach its own tips. With centroids no point
leaves the hull of the true workspace, and the error is of second order.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, F4, named
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.densities import Densities

Counts = NDArray[np.float64]
Vector = NDArray[np.float64]

# The counts of a level are float64 times two to a common exponent. Counts above PEAK are scaled down. Counts that would
# underflow are set to FLOOR, so that the edge of the workspace survives any number of modules.
PEAK, SHIFT, FLOOR = 2.0**960, 900, 2.0**-1000


class Level(NamedTuple):
    """One intermediate workspace during the mapping."""

    counts: Counts  # number of configurations in each pixel, divided by two to the power of `exponent`, shape (z, y, x)
    centroids: Counts  # mean position of the points of each pixel, shape (z, y, x, 3)
    exponent: int  # see `counts`
    reference: Vector  # centre of the first pixel, shape (3,)
    pixel: float  # side of the pixels


LEVEL = named(Level, F3, F4, int64, F1, float64)


def map_densities(
    manipulator: Manipulator,
    pixel: float,
    level_pixels: int,
    progress: Callable[[int], None] = lambda levels: None,
) -> Densities:
    """Returns the densities of all intermediate workspaces (section 3.1.1); the base frame is not used.

    `pixel` is the finest side of a pixel, in the arm's unit of length. A level has at most `level_pixels`; the pixels
    of larger levels are coarser. `progress` is called with the number of levels done, at last B+1. Raises ValueError
    unless both bounds are positive.
    """
    if pixel <= 0 or level_pixels < 1:
        raise ValueError(f"pixel {pixel:g} and pixels per level {level_pixels} must be positive")
    level = tip_level(pixel)
    levels = [packed(level)]
    progress(1)
    for i in reversed(range(len(manipulator.modules))):
        level = below(level, manipulator, i, level_pixels)
        levels.append(packed(level))
        progress(len(levels))
    levels.reverse()
    return Densities(
        values=np.concatenate([values.ravel() for values, _, _ in levels]),
        offsets=np.cumsum([0] + [values.size for values, _, _ in levels]),
        shapes=np.array([values.shape for values, _, _ in levels]),
        references=np.array([reference for _, reference, _ in levels]),
        pixels=np.array([pixel for _, _, pixel in levels]),
    )


def tip_level(pixel: float) -> Level:
    """Returns the intermediate workspace of the tip alone: one point."""
    return Level(np.ones((1, 1, 1)), np.zeros((1, 1, 1, 3)), 0, np.zeros(3), pixel)


def below(level: Level, manipulator: Manipulator, i: int, level_pixels: int) -> Level:
    """Returns the intermediate workspace below: `level` moved by all states of module i (0 at the base)."""
    rotations = manipulator.rotations[i, : manipulator.states[i]]
    translations = manipulator.translations[i, : manipulator.states[i]]
    low, high = extent(level.counts, level.reference, level.pixel, rotations, translations)
    pixel = coarsened(level.pixel, low, high, level_pixels, manipulator.dimension)
    shape, reference = grid(low, high, pixel)
    lower = Level(np.zeros(shape), np.zeros((*shape, 3)), level.exponent, reference, pixel)
    superpose(level, rotations, translations, lower)
    return lower._replace(exponent=level.exponent + rescale(lower.counts))


def packed(level: Level) -> tuple[NDArray[np.float32], Vector, float]:
    """Returns values, reference and pixel of a level for Densities."""
    return logarithms(level.counts, level.exponent, level.pixel), level.reference, level.pixel


def coarsened(pixel: float, low: Vector, high: Vector, level_pixels: int, dimension: int) -> float:
    """Returns a side of at least `pixel` for which the box `low` to `high` has at most `level_pixels` pixels."""
    while (excess := math.prod(grid(low, high, pixel)[0]) / level_pixels) > 1:
        pixel *= max(excess ** (1 / dimension), 1.01)
    return pixel


def grid(low: Vector, high: Vector, pixel: float) -> tuple[tuple[int, int, int], Vector]:
    """Returns shape (z, y, x) and reference of the pixels that cover the box `low` to `high`."""
    first, last = np.round(low / pixel), np.round(high / pixel)
    nx, ny, nz = (last - first).astype(int) + 1
    return (nz, ny, nx), first * pixel


def rescale(counts: Counts) -> int:
    """Scales counts down in place if they are near overflow; returns the exponent of two removed."""
    if counts.max() < PEAK:
        return 0
    reachable = counts > 0
    counts *= 2.0**-SHIFT
    counts[reachable] = np.maximum(counts[reachable], FLOOR)
    return SHIFT


def logarithms(counts: Counts, exponent: int, pixel: float) -> NDArray[np.float32]:
    """Returns the values of one level: ln of the count, or minus the distance to the nearest pixel with points."""
    from scipy.ndimage import (
        distance_transform_edt,  # imported here: a planner with cached densities saves 5 MiB
    )

    reachable = counts > 0
    values = -pixel * distance_transform_edt(~reachable)
    # A count that rescale set to FLOOR is at least 1.
    values[reachable] = np.maximum(np.log(counts[reachable]) + exponent * math.log(2.0), 0.0)
    return np.asarray(values, dtype=np.float32)


@kernel("UniTuple(f8[::1],2)(f8[:,:,::1], f8[::1], f8, f8[:,:,::1], f8[:,::1])")
def extent(
    counts: Counts, reference: Vector, pixel: float, rotations: Counts, translations: Counts
) -> tuple[Vector, Vector]:
    """Returns a box of all points after all motions. The ends of the rows suffice: their hull is the hull of all."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    depth, height, width = counts.shape
    for z in range(depth):
        for y in range(height):
            first, last = 0, width - 1
            while first < width and counts[z, y, first] == 0:
                first += 1
            while last > first and counts[z, y, last] == 0:
                last -= 1
            if first == width:
                continue
            for x in (first, last):
                for j in range(len(rotations)):
                    for a in range(3):
                        p = translations[j, a]
                        p += rotations[j, a, 0] * (reference[0] + x * pixel)
                        p += rotations[j, a, 1] * (reference[1] + y * pixel)
                        p += rotations[j, a, 2] * (reference[2] + z * pixel)
                        low[a], high[a] = min(low[a], p), max(high[a], p)
    for a in range(3):  # points are up to a pixel from the centres; planar arms have no extent in z
        if a < 2 or depth > 1 or low[a] != 0 or high[a] != 0:
            low[a] -= pixel
            high[a] += pixel
    return low, high


@kernel(
    types.void(LEVEL, F3, F2, LEVEL),
    error_model="numpy",
)
def superpose(upper: Level, rotations: Counts, translations: Counts, lower: Level) -> None:
    """Adds a level, moved by each (R, b), to the level below. The points of a pixel move with their centroid."""
    source, source_centroids, _, _, _ = upper
    target, target_centroids, _, reference, pixel = lower
    depth, height, width = source.shape
    for j in range(len(rotations)):
        r, b = rotations[j], translations[j]
        for z in range(depth):
            for y in range(height):
                for x in range(width):
                    count = source[z, y, x]
                    if count > 0:
                        c = source_centroids[z, y, x]
                        px = b[0] + r[0, 0] * c[0] + r[0, 1] * c[1] + r[0, 2] * c[2]
                        py = b[1] + r[1, 0] * c[0] + r[1, 1] * c[1] + r[1, 2] * c[2]
                        pz = b[2] + r[2, 0] * c[0] + r[2, 1] * c[1] + r[2, 2] * c[2]
                        tx = int((px - reference[0]) / pixel + 0.5)
                        ty = int((py - reference[1]) / pixel + 0.5)
                        tz = int((pz - reference[2]) / pixel + 0.5)
                        total = target[tz, ty, tx] + count
                        share = count / total
                        t = target_centroids[tz, ty, tx]
                        t[0] += share * (px - t[0])
                        t[1] += share * (py - t[1])
                        t[2] += share * (pz - t[2])
                        target[tz, ty, tx] = total
