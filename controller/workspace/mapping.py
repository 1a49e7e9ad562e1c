"""The Mapping Algorithm (section 3.1.1): point densities of all intermediate workspaces, from the tip to the base.

W_{i-1} is the superposition, over the configurations (R, b) of module i, of W_i moved by (R, b). Every level has as
many pixels at most as the memory bound allows, so time and memory grow linearly with the number of modules.

While mapping, each pixel also carries the centroid of its points, and it is the centroid that moves. Moved pixel
centres would be rounded again at every module: an arm of many modules, whose pixels are larger than a module's step,
would not reach its own goal. With centroids no point leaves the hull of the true workspace, and the error is of second
order.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.manipulator.manipulator import Manipulator
from controller.workspace.densities import Densities

Counts = NDArray[np.float64]
Vector = NDArray[np.float64]

# Counts of one level are held as float64 times two to a common exponent. Past PEAK they are scaled down, and what would
# vanish by that is kept at FLOOR, so that the edge of the workspace survives for any number of modules.
PEAK, SHIFT, FLOOR = 2.0**960, 900, 2.0**-1000


class Level(NamedTuple):
    """One intermediate workspace while it is mapped.

    Attributes:
        counts: number of configurations in each pixel, divided by two to `exponent`, shape (z, y, x).
        centroids: mean position of the points of each pixel, shape (z, y, x, 3).
        exponent: see `counts`.
        reference: centre of the first pixel.
        pixel: side of the pixels.
    """

    counts: Counts
    centroids: Counts
    exponent: int
    reference: Vector
    pixel: float


def map_densities(
    manipulator: Manipulator,
    pixel: float,
    level_pixels: int,
    progress: Callable[[int], None] = lambda levels: None,
) -> Densities:
    """Returns the densities of all intermediate workspaces.

    Args:
        manipulator: the arm; its base frame plays no part.
        pixel: finest side of a pixel, in the arm's unit of length.
        level_pixels: most pixels of one level; a level that needs more gets coarser pixels.
        progress: called with the number of levels done so far, B+1 in all.

    Raises:
        ValueError: a bound is not positive.
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
    """Returns the intermediate workspace next to the base: `level` moved by all states of module i (0 at the base)."""
    rotations = manipulator.rotations[i, : manipulator.states[i]]
    translations = manipulator.translations[i, : manipulator.states[i]]
    low, high = extent(level.counts, level.reference, level.pixel, rotations, translations)
    pixel = coarsened(level.pixel, low, high, level_pixels, manipulator.dimension)
    shape, reference = grid(low, high, pixel)
    counts, centroids = np.zeros(shape), np.zeros((*shape, 3))
    superpose(level.counts, level.centroids, rotations, translations, counts, centroids, reference, pixel)
    return Level(counts, centroids, level.exponent + rescale(counts), reference, pixel)


def packed(level: Level) -> tuple[NDArray[np.float32], Vector, float]:
    """Returns values, reference and pixel of a level as Densities has them."""
    return logarithms(level.counts, level.exponent, level.pixel), level.reference, level.pixel


def coarsened(pixel: float, low: Vector, high: Vector, level_pixels: int, dimension: int) -> float:
    """Returns `pixel`, or nearly the least side above it that gives the box `low` to `high` at most `level_pixels`."""
    while (excess := math.prod(grid(low, high, pixel)[0]) / level_pixels) > 1:
        pixel *= max(excess ** (1 / dimension), 1.01)
    return pixel


def grid(low: Vector, high: Vector, pixel: float) -> tuple[tuple[int, int, int], Vector]:
    """Returns shape (z, y, x) and reference of the pixels that hold all points from `low` to `high`."""
    first, last = np.round(low / pixel), np.round(high / pixel)
    nx, ny, nz = (last - first).astype(int) + 1
    return (nz, ny, nx), first * pixel


def rescale(counts: Counts) -> int:
    """Scales counts down in place when they come near overflow; returns the exponent of two taken out."""
    if counts.max() < PEAK:
        return 0
    reachable = counts > 0
    counts *= 2.0**-SHIFT
    counts[reachable] = np.maximum(counts[reachable], FLOOR)
    return SHIFT


def logarithms(counts: Counts, exponent: int, pixel: float) -> NDArray[np.float32]:
    """Returns the values of one level: ln of the count, or minus the distance to the nearest pixel with one."""
    from scipy.ndimage import (
        distance_transform_edt,  # 5 MiB that a planner with its densities in the cache does not need
    )

    reachable = counts > 0
    values = -pixel * distance_transform_edt(~reachable)
    # What rescale kept at FLOOR is a count of at least one, whatever its scaled value says.
    values[reachable] = np.maximum(np.log(counts[reachable]) + exponent * math.log(2.0), 0.0)
    return np.asarray(values, dtype=np.float32)


@njit("UniTuple(f8[::1],2)(f8[:,:,::1], f8[::1], f8, f8[:,:,::1], f8[:,::1])", cache=True, nogil=True)
def extent(
    counts: Counts, reference: Vector, pixel: float, rotations: Counts, translations: Counts
) -> tuple[Vector, Vector]:
    """Returns a box of all points after every motion: from the rows' ends, whose hull is that of the whole."""
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
    for a in range(3):  # the points lie around the pixels' centres; a planar arm's have no room in z
        if a < 2 or depth > 1 or low[a] != 0 or high[a] != 0:
            low[a] -= pixel
            high[a] += pixel
    return low, high


@njit(
    "void(f8[:,:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,:,::1], f8[::1], f8)",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def superpose(
    source: Counts,
    source_centroids: Counts,
    rotations: Counts,
    translations: Counts,
    target: Counts,
    target_centroids: Counts,
    reference: Vector,
    pixel: float,
) -> None:
    """Fills `target` with the source's points moved by every (R, b), a pixel's points to where their centroid goes."""
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
