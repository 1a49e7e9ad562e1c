"""The density of two joined segments as their convolution on SE(3), for spatial arms.

As in convolution, (f * g)(h) = sum over k of f(k) g(k^-1 h), with a grid of rotations for the orientations: for each
rotation of f, g is turned by it and convolved with that slice of f in space, by FFT. Turning by a rotation of the grid
is turning by one of its lattice, which resamples, and then by one of the cube, which only exchanges pixels.

What lies between rotations or between pixels is shared so that mean rotation, mean position and mean square distance
stay what they are: nothing blurs, and joining changes none of these three, for any number of modules. The price are
shares below 0, where the density changes faster than the grid can tell. So a segment is not halved while its halves
hardly turn: many random configurations of it stand for all, and doubling begins there.
"""

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from controller.manipulator.manipulator import Manipulator
from controller.workspace.doubling import doubled, every_end, few
from controller.workspace.rotation_grid import CUBE, RotationGrid, turned

Array = NDArray[np.float64]
Waves = NDArray[np.complex128]

LEAST = 15  # pixels along a box: with fewer, the margins of two joined grow faster than the arm
BROAD = 0.5  # of the grid's step: the standard deviation about each axis that two segments need to be joined
DRAWN = 100_000  # configurations of a segment too narrow to be halved
AT_ONCE = 4000  # tips, of some 10 kB each while they are shared
ROUNDING = 1e-15  # of the greatest share: less is not known after FFTs


@dataclass(frozen=True, eq=False)
class SpatialDensity:
    """Shares of the configurations of a segment, whose sum is 1.

    Attributes:
        shares: slice k at rotation k of the grid, pixels of a cube about the origin, shape (rotations, n, n, n), along
            z, y, x; n is odd. Some are a little below 0.
        pixel: side of the pixels.
        grid: of the rotations.
        configurations: natural logarithm of how many there are in all.
    """

    shares: Array
    pixel: float
    grid: RotationGrid
    configurations: float

    @property
    def values(self) -> NDArray[np.float32]:
        """Natural logarithm of the number of configurations in each pixel, -inf where there are none."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.maximum(self.shares, 0.0)) + self.configurations, dtype=np.float32)

    @property
    def filled(self) -> Array:
        """Centres of the pixels that have shares at any rotation, shape (n, 3)."""
        zyx = np.argwhere(self.shares.any(axis=0)) - self.shares.shape[1] // 2
        return np.asarray(self.pixel * zyx[:, ::-1], dtype=np.float64)


def by_spatial_convolution(manipulator: Manipulator, pixel: float, level_pixels: int, along: int) -> SpatialDensity:
    """Returns the density of the whole arm's tips as seen from its base, a segment that comes again computed once.

    Args:
        manipulator: the arm; its base frame plays no part.
        pixel: finest side of a pixel, in the arm's unit of length.
        level_pixels: most pixels of a density, eight bytes each (some seven times as much while two are convolved); a
            segment that needs more gets coarser pixels.
        along: fineness of the grid of rotations, see RotationGrid.

    Raises:
        ValueError: a bound is not positive, or there are too few pixels for the rotations.
    """
    if pixel <= 0 or along < 1 or level_pixels < LEAST**3 * 24 * along**3:
        raise ValueError(
            f"pixel {pixel:g} and fineness of rotations {along} must be positive,"
            f" and pixels {level_pixels} at least {LEAST}^3 for each of {24 * along**3} rotations"
        )
    grid = RotationGrid(along)
    most = 1
    while (2 * most + 3) ** 3 * len(grid.rotations) <= level_pixels:
        most += 1
    return doubled(
        manipulator,
        lambda segment: few(segment) or narrow(segment, grid),
        lambda segment: begun(segment, pixel, most, grid),
        lambda lower, upper: convolution(lower, upper, most),
    )


def narrow(manipulator: Manipulator, grid: RotationGrid) -> bool:
    """Tells whether the grid is too coarse for the orientations of the halves of a segment."""
    mean = reduce(np.matmul, [module.frames[:, :3, :3].mean(axis=0) for module in manipulator.modules])
    # Small turns of variance v about each axis have the mean matrix exp(-v), and halves have half of it.
    least = math.exp(-2 * (BROAD * math.pi / 2 / grid.along) ** 2)
    return float(np.linalg.norm(mean)) > least * math.sqrt(3)


def begun(manipulator: Manipulator, pixel: float, most: int, grid: RotationGrid) -> SpatialDensity:
    """Returns the density of a segment, of all its configurations or of many drawn at random.

    Args:
        manipulator: the segment.
        pixel: finest side of a pixel.
        most: pixels from the origin to the sides of the cube.
        grid: of the rotations.
    """
    if few(manipulator) or len(manipulator.modules) == 1:
        tips = every_end(manipulator)
    else:
        random = np.random.default_rng(0)
        tips = manipulator.tips(random.integers(0, manipulator.states, (DRAWN, len(manipulator.states))))
    reach = float(np.abs(tips[:, :3, 3]).max())
    pixel = max(pixel, reach / (most - 1.5))
    shares = np.zeros((len(grid.rotations), *box(reach, pixel)))
    for some in np.array_split(tips, -(-len(tips) // AT_ONCE)):
        cells, parts = grid.shares(some[:, :3, :3])
        scatter(np.ascontiguousarray(some[:, :3, 3]), cells, parts / len(tips), shares, pixel)
    return SpatialDensity(shares, pixel, grid, float(np.log(manipulator.states).sum()))


def convolution(lower: SpatialDensity, upper: SpatialDensity, most: int) -> SpatialDensity:
    """Returns the density of a lower segment (base side) joined with an upper one, within the same bound."""
    grid, m = lower.grid, len(lower.grid.lattice)
    reaches = np.abs(lower.filled).max(), np.linalg.norm(upper.filled, axis=1).max()
    pixel = max(lower.pixel, upper.pixel, sum(reaches) / (most - 3))
    f_box, g_box = (box(reach, pixel) for reach in reaches)
    side = f_box[0] + g_box[0] - 1
    padded = (fft.next_fast_len(side, real=True),) * 3
    f = resampled(lower.shares, lower.pixel, np.eye(3), f_box, pixel).reshape(len(CUBE), m, *f_box)
    f_waves = np.stack([waves(turned(f[o], turn.T), padded) for o, turn in enumerate(CUBE)])  # o, c, wave
    f_waves = np.ascontiguousarray(f_waves.transpose(2, 0, 1))
    shares, g_shares = np.zeros((len(CUBE), m, side, side, side)), upper.shares.reshape(len(upper.shares), -1)
    for k, last in enumerate(CUBE):  # rotations k m to k m + m - 1 of the upper segment, turned by the lattice
        g_waves = np.empty((m, m, f_waves.shape[0]), dtype=np.complex128)
        for c, rotation in enumerate(grid.lattice):
            g = (grid.after[c][k * m : k * m + m] @ g_shares).reshape(m, *upper.shares.shape[1:])
            g_waves[c] = waves(resampled(g, upper.pixel, rotation, g_box, pixel), padded)
        products = f_waves @ np.ascontiguousarray(g_waves.transpose(2, 0, 1))  # the sum over the lattice, for each turn
        for o, turn in enumerate(CUBE):
            spectra = products[:, o].T.reshape(m, *padded[:2], -1)
            joined = fft.irfftn(spectra, padded, axes=(1, 2, 3))[:, :side, :side, :side]
            whole = np.abs(CUBE - turn @ last).sum(axis=(1, 2)).argmin()
            shares[whole] += turned(joined, turn)
    return trimmed(
        SpatialDensity(shares.reshape(-1, side, side, side), pixel, grid, lower.configurations + upper.configurations)
    )


def box(reach: float, pixel: float) -> tuple[int, int, int]:
    """Returns the shape of a cube about the origin for all that lies up to `reach` from it along each axis."""
    side = 2 * (math.floor(reach / pixel + 0.5) + 1) + 1
    return side, side, side


def waves(boxes: Array, padded: tuple[int, int, int]) -> Waves:
    """Returns the Fourier transforms of boxes (n, z, y, x), padded with zeros, shape (n, waves)."""
    return np.asarray(fft.rfftn(boxes, padded, axes=(1, 2, 3)).reshape(len(boxes), -1))


def resampled(boxes: Array, own: float, rotation: Array, shape: tuple[int, int, int], pixel: float) -> Array:
    """Returns boxes (n, z, y, x) of pixels `own` turned by a rotation, in cubes of another shape and pixel."""
    target = np.zeros((*shape, len(boxes)))
    spread(np.ascontiguousarray(np.moveaxis(boxes, 0, -1)), own, rotation, target, pixel)
    return np.moveaxis(target, -1, 0)


def trimmed(density: SpatialDensity) -> SpatialDensity:
    """Returns the density without what rounding made and without the margin that is left empty."""
    shares = density.shares
    shares[np.abs(shares) <= ROUNDING * np.abs(shares).max()] = 0.0
    middle = shares.shape[1] // 2
    half = int(np.abs(np.argwhere(shares.any(axis=0)) - middle).max())
    kept = slice(middle - half, middle + half + 1)
    shares = np.ascontiguousarray(shares[:, kept, kept, kept])
    return SpatialDensity(shares, density.pixel, density.grid, density.configurations)


@njit("Tuple((i8, UniTuple(f8,3)))(f8)", cache=True, nogil=True)
def three(x: float) -> tuple[int, tuple[float, float, float]]:
    """Returns the first of the three whole numbers around x, and shares whose sum is 1, mean x, and mean square x^2."""
    middle = math.floor(x + 0.5)
    r = x - middle
    return middle - 1, (r * (r - 1) / 2, 1 - r * r, r * (r + 1) / 2)


@njit("void(f8[:,::1], i8[:,::1], f8[:,::1], f8[:,:,:,::1], f8)", cache=True, nogil=True)
def scatter(points: Array, cells: NDArray[np.int64], parts: Array, shares: Array, pixel: float) -> None:
    """Adds each point's parts (n, k) at its rotations (n, k) to the 27 pixels around its position (n, 3)."""
    half = shares.shape[1] // 2
    for n in range(len(points)):
        ix, sx = three(points[n, 0] / pixel + half)
        iy, sy = three(points[n, 1] / pixel + half)
        iz, sz = three(points[n, 2] / pixel + half)
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    share = sz[a] * sy[b] * sx[c]
                    for k in range(cells.shape[1]):
                        shares[cells[n, k], iz + a, iy + b, ix + c] += share * parts[n, k]


@njit("void(f8[:,:,:,::1], f8, f8[:,:], f8[:,:,:,::1], f8)", cache=True, nogil=True)
def spread(source: Array, own: float, rotation: Array, target: Array, pixel: float) -> None:
    """Adds the source (z, y, x, n), turned, to the target: each share to the 27 pixels around where it comes to lie."""
    side, number = source.shape[0], source.shape[3]
    half, center = side // 2, target.shape[0] // 2
    p = np.empty(3)
    for z in range(side):
        for y in range(side):
            for x in range(side):
                own_shares = source[z, y, x]
                if not own_shares.any():
                    continue
                for a in range(3):
                    turned_by = rotation[a, 0] * (x - half) + rotation[a, 1] * (y - half) + rotation[a, 2] * (z - half)
                    p[a] = turned_by * own / pixel + center
                ix, sx = three(p[0])
                iy, sy = three(p[1])
                iz, sz = three(p[2])
                for a in range(3):
                    for b in range(3):
                        for c in range(3):
                            share = sz[a] * sy[b] * sx[c]
                            if share != 0:
                                place = target[iz + a, iy + b, ix + c]
                                for k in range(number):
                                    place[k] += share * own_shares[k]
