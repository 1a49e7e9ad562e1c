"""The density of two joined segments as their convolution on SE(2), planar arms only.

Where f and g say what share of the configurations of the lower and of the upper segment ends at each frame, the share
of the arm made of both is (f * g)(h) = sum over k of f(k) g(k^-1 h) (section 2.1). For each orientation of f, g is
turned by it and convolved with that slice of f in the plane, by FFT; the orientations add. Equal segments have equal
densities: an arm that repeats itself takes O(log B) convolutions, each within the bound on pixels.

The Mapping Algorithm is exact but for its pixels and gives every intermediate workspace; here only those segments come
out that were joined. Turning and resampling spread what lies between pixels over the four around it: mass and mean
position of the turned density stay, but it blurs. And the FFT knows no share smaller than its rounding error, some
1e-16 of the greatest: of long arms the edge of the workspace is lost.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from controller.manipulator.manipulator import Manipulator
from controller.workspace.doubling import doubled, every_end, few

Array = NDArray[np.float64]

LEAST = 25  # pixels for each orientation: 3 x 3 hold any density with huge pixels, and 5 x 5 the sum of two
EDGE = 1e-6  # pixels: what lies on a pixel's centre may be rounded to either side of it


@dataclass(frozen=True, eq=False)
class PlanarDensity:
    """Shares of the configurations of a planar segment, whose sum is 1.

    Attributes:
        shares: slice k at orientation 2 pi k / turns, pixel (y, x) at `reference + pixel * (x, y)`,
            shape (turns, y, x).
        reference: centre of the first pixel, x, y, a whole number of pixels from the origin.
        pixel: side of the pixels.
        configurations: natural logarithm of how many there are in all.
    """

    shares: Array
    reference: Array
    pixel: float
    configurations: float

    @property
    def values(self) -> NDArray[np.float32]:
        """Natural logarithm of the number of configurations in each pixel, -inf where there are none."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.shares) + self.configurations, dtype=np.float32)


def by_convolution(manipulator: Manipulator, pixel: float, level_pixels: int, turns: int) -> PlanarDensity:
    """Returns the density of the whole arm's tips as seen from its base, a segment that comes again computed once.

    Args:
        manipulator: a planar arm; its base frame plays no part.
        pixel: finest side of a pixel, in the arm's unit of length.
        level_pixels: most pixels of a density, eight bytes each (some 15 times as much while two are convolved); a
            segment that needs more gets coarser pixels.
        turns: orientations told apart.

    Raises:
        ValueError: the arm is not planar, a bound is not positive, or there are too few pixels for the orientations.
    """
    if not manipulator.planar:
        raise ValueError("convolution on SE(2) is for planar arms, this one is spatial: see spatial_convolution")
    if pixel <= 0 or turns < 1 or level_pixels < LEAST * turns:
        raise ValueError(
            f"pixel {pixel:g} and orientations {turns} must be positive,"
            f" and pixels {level_pixels} at least {LEAST} for each orientation"
        )
    return doubled(
        manipulator,
        few,
        lambda segment: enumerated(segment, pixel, level_pixels, turns),
        lambda lower, upper: convolution(lower, upper, level_pixels),
    )


def enumerated(manipulator: Manipulator, pixel: float, level_pixels: int, turns: int) -> PlanarDensity:
    """Returns the density of a segment by trying all its configurations."""
    tips = every_end(manipulator)
    points = np.column_stack((tips[:, :2, 3], np.arctan2(tips[:, 1, 0], tips[:, 0, 0])))
    ends = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    pixel = fitted([ends], pixel, level_pixels // turns)
    shape, reference = box(*ends, pixel)
    shares = np.zeros((turns, *shape))
    scatter(points, np.full(len(points), 1 / len(points)), shares, reference, pixel)
    return PlanarDensity(shares, reference, pixel, math.log(len(points)))


def convolution(lower: PlanarDensity, upper: PlanarDensity, level_pixels: int) -> PlanarDensity:
    """Returns the density of a lower segment (base side) joined with an upper one."""
    turns = len(lower.shares)
    angles: Array = 2 * math.pi / turns * np.arange(turns, dtype=np.float64)
    lower_slices, upper_slices = (np.flatnonzero(d.shares.any(axis=(1, 2))) for d in (lower, upper))
    f_ends, g_ends = corners(lower, np.zeros(1)), corners(upper, angles[lower_slices])
    pixel = fitted([f_ends, g_ends], max(lower.pixel, upper.pixel), level_pixels // turns)
    (f_shape, f_reference), (g_shape, g_reference) = box(*f_ends, pixel), box(*g_ends, pixel)
    shape = f_shape[0] + g_shape[0] - 1, f_shape[1] + g_shape[1] - 1
    padded = [fft.next_fast_len(n, real=True) for n in shape]
    f, g = np.empty((turns, *f_shape)), np.empty((turns, *g_shape))
    spread(lower.shares, lower.reference, lower.pixel, 0.0, f, f_reference, pixel)
    f_waves = fft.rfft2(f, padded)
    waves = np.zeros_like(f_waves)
    for i in lower_slices:
        spread(upper.shares, upper.reference, upper.pixel, angles[i], g, g_reference, pixel)
        for j in upper_slices:
            waves[(i + j) % turns] += f_waves[i] * fft.rfft2(g[j], padded)
    shares = fft.irfft2(waves, padded)[:, : shape[0], : shape[1]]
    # No share is negative: the least that came out tells how far rounding goes, and what is as small is not known.
    shares[shares <= max(0.0, -2 * shares.min())] = 0.0
    filled = shares.any(axis=0)
    rows, columns = np.flatnonzero(filled.any(axis=1)), np.flatnonzero(filled.any(axis=0))
    shares = shares[:, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    reference = f_reference + g_reference + pixel * np.array([columns[0], rows[0]])
    return PlanarDensity(shares / shares.sum(), reference, pixel, lower.configurations + upper.configurations)


def corners(density: PlanarDensity, angles: Array) -> tuple[Array, Array]:
    """Returns the least and greatest position (2,) of the pixels with shares, turned by any of the angles."""
    y, x = np.nonzero(density.shares.any(axis=0))
    points = density.reference + density.pixel * np.column_stack((x, y))
    turned = [points @ [[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]] for a in angles]
    return np.min([t.min(axis=0) for t in turned], axis=0), np.max([t.max(axis=0) for t in turned], axis=0)


def box(low: Array, high: Array, pixel: float) -> tuple[tuple[int, int], Array]:
    """Returns shape (y, x) and reference of the pixels around all positions from `low` to `high`."""
    first, last = np.floor(low / pixel - EDGE), np.floor(high / pixel + EDGE) + 1
    nx, ny = (last - first).astype(int) + 1
    return (int(ny), int(nx)), first * pixel


def fitted(ends: list[tuple[Array, Array]], pixel: float, most: int) -> float:
    """Returns `pixel`, or nearly the least side above it that gives the sum of these boxes at most so many pixels."""
    while True:
        shapes = np.array([box(*corner, pixel)[0] for corner in ends])
        excess = float(np.prod(shapes.sum(axis=0) - len(ends) + 1) / most)
        if excess <= 1:
            return pixel
        pixel *= max(math.sqrt(excess), 1.01)


@njit("void(f8[:,::1], f8[::1], f8[:,:,::1], f8[::1], f8)", cache=True, nogil=True)
def scatter(points: Array, weights: Array, shares: Array, reference: Array, pixel: float) -> None:
    """Adds points (x, y, angle) to the eight pixels around each, near ones more, so that their mean is the point."""
    turns = len(shares)
    for n in range(len(points)):
        x, y = (points[n, 0] - reference[0]) / pixel, (points[n, 1] - reference[1]) / pixel
        t = points[n, 2] * turns / (2 * math.pi)
        kx, ky, kt = math.floor(x), math.floor(y), math.floor(t)
        for dt in range(2):
            for dy in range(2):
                for dx in range(2):
                    share = weights[n] * abs(1 - dt - (t - kt)) * abs(1 - dy - (y - ky)) * abs(1 - dx - (x - kx))
                    if share > 0:
                        shares[(kt + dt) % turns, ky + dy, kx + dx] += share


@njit("void(f8[:,:,::1], f8[::1], f8, f8, f8[:,:,::1], f8[::1], f8)", cache=True, nogil=True)
def spread(
    source: Array,
    source_reference: Array,
    source_pixel: float,
    angle: float,
    target: Array,
    reference: Array,
    pixel: float,
) -> None:
    """Fills `target` with the source turned by `angle` about the origin, each share among the four pixels around it."""
    target[:] = 0.0
    turns, height, width = source.shape
    cosine, sine = math.cos(angle), math.sin(angle)
    for iy in range(height):
        for ix in range(width):
            px, py = source_reference[0] + ix * source_pixel, source_reference[1] + iy * source_pixel
            x = (cosine * px - sine * py - reference[0]) / pixel
            y = (sine * px + cosine * py - reference[1]) / pixel
            kx, ky = math.floor(x), math.floor(y)
            fx, fy = x - kx, y - ky
            for k in range(turns):
                share = source[k, iy, ix]
                if share > 0:
                    target[k, ky, kx] += share * (1 - fx) * (1 - fy)
                    target[k, ky, kx + 1] += share * fx * (1 - fy)
                    target[k, ky + 1, kx] += share * (1 - fx) * fy
                    target[k, ky + 1, kx + 1] += share * fx * fy
