"""Pixels of frames: in which pixel of R^2 x SO(2) or R^3 x SO(3) a frame lies, and tables of the pixels with points.

A pixel is a cell of the position, a square or a cube, times a cell of the rotation. Cells of SO(2) are equal arcs, the
index periodic. Cells of SO(3) are the cubes of an even grid in the cubochoric cube (Rosca, Morawiec, De Graef 2014, A
new method of constructing a grid in the space of 3D rotations). The map from this cube to rotations keeps volumes, so
all cells have the same measure, exactly.

Of the six-dimensional pixels few ever have points, so a level is a table: sorted keys, and a hash table while it fills.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Keys = NDArray[np.int64]

SIDE = math.pi ** (2 / 3)  # of the cubochoric cube, whose volume is that of the ball of rotations
SCALE = (math.pi / 6) ** (1 / 6)
RADIUS = (0.75 * math.pi) ** (1 / 3)
TWELFTH = math.pi / 12
# The constants of the two maps that together turn the cube's square sections into circles, and these into a sphere.
SQUARE, SPHERE = (math.pi ** (5 / 6) / 6 ** (1 / 6) / 2) / (math.sqrt(2) * RADIUS), math.sqrt(6 / math.pi)
TINY = 1e-30  # a square too small for its powers to be divided by
HASH = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio: multiplied by it, neighbours are spread


@njit("UniTuple(f8,3)(f8,f8,f8,f8)", cache=True, nogil=True)
def pyramid(x: float, y: float, z: float, radius: float) -> tuple[float, float, float]:
    """Returns the point of the cube for one of the ball, |z| being the greatest of its coordinates."""
    q = math.sqrt(2.0 * radius / (radius + abs(z)))
    x, y, z = x * q, y * q, math.copysign(radius, z) / SPHERE
    if x * x + y * y < TINY:
        return 0.0, 0.0, z / SCALE
    swapped = abs(y) > abs(x)
    if swapped:
        x, y = y, x
    square = x * x + y * y
    double = square + x * x
    root = math.sqrt(double)
    q = SQUARE * math.sqrt(double * square / (double - abs(x) * root))
    turn = math.acos(min(1.0, (y * y + abs(x) * root) / (math.sqrt(2.0) * square)))
    x, y = math.copysign(q, x), math.copysign(q * turn / TWELFTH, y)
    if swapped:
        x, y = y, x
    return x / SCALE, y / SCALE, z / SCALE


@njit("UniTuple(f8,3)(f8,f8,f8,f8)", cache=True, nogil=True)
def cubochoric(qx: float, qy: float, qz: float, qw: float) -> tuple[float, float, float]:
    """Returns the point of the cube for a rotation, from its quaternion of any length but 0."""
    sine = math.sqrt(qx * qx + qy * qy + qz * qz)
    if sine * sine < TINY:
        return 0.0, 0.0, 0.0
    angle = 2.0 * math.atan2(sine, abs(qw))
    # Homochoric: 3/4 (angle - sin angle) is the volume within that angle; the series where the difference cancels.
    volume = angle**3 / 6 * (1 - angle**2 / 20 * (1 - angle**2 / 42)) if angle < 0.1 else angle - math.sin(angle)
    radius = (0.75 * volume) ** (1 / 3)
    factor = (radius if qw >= 0 else -radius) / sine
    x, y, z = qx * factor, qy * factor, qz * factor
    if abs(x) > abs(y) and abs(x) > abs(z):
        cy, cz, cx = pyramid(y, z, x, radius)
    elif abs(y) > abs(z):
        cz, cx, cy = pyramid(z, x, y, radius)
    else:
        cx, cy, cz = pyramid(x, y, z, radius)
    return cx, cy, cz


@njit("i8(f8[::1], b1, i8)", cache=True, nogil=True)
def rotation_cell(frame: Array, planar: bool, turns: int) -> int:
    """Returns the index of the cell that a frame's rotation lies in, of `turns` (planar) or `turns`^3 cells."""
    if planar:
        return round(math.atan2(frame[5], frame[6]) / math.pi * turns) % turns
    index = 0
    for c in cubochoric(frame[3], frame[4], frame[5], frame[6]):
        index = index * turns + min(max(int((c / SIDE + 0.5) * turns), 0), turns - 1)
    return index


@njit("i8(f8[::1], f8[::1], f8, i8[::1], b1, i8)", cache=True, nogil=True)
def key(frame: Array, reference: Array, pixel: float, shape: Keys, planar: bool, turns: int) -> int:
    """Returns the key of the pixel that a frame lies in, -1 if it is outside the level's box.

    Args:
        frame: position x, y, z and quaternion x, y, z, w of any length but 0, shape (7,).
        reference: centre of the first pixel.
        pixel: side of the pixels.
        shape: pixels along z, y, x.
        planar: whether rotations are those of SO(2).
        turns: cells of a full turn, or along an edge of the cube.
    """
    index = 0
    for a in (2, 1, 0):
        cell = math.floor((frame[a] - reference[a]) / pixel + 0.5)
        if cell < 0 or cell >= shape[2 - a]:
            return -1
        index = index * shape[2 - a] + cell
    return index * (turns if planar else turns**3) + rotation_cell(frame, planar, turns)


@njit("void(f8[::1], f8[::1], f8[:,::1], f8[::1], f8[::1])", cache=True, nogil=True)
def carry(frame: Array, quaternion: Array, rotation: Array, translation: Array, moved: Array) -> None:
    """Writes `frame` moved by (R, b), the quaternion of R given as well; the result's quaternion has length 1."""
    for a in range(3):
        moved[a] = translation[a]
        for b in range(3):
            moved[a] += rotation[a, b] * frame[b]
    px, py, pz, pw = quaternion
    x, y, z, w = frame[3], frame[4], frame[5], frame[6]
    moved[3] = pw * x + px * w + py * z - pz * y
    moved[4] = pw * y - px * z + py * w + pz * x
    moved[5] = pw * z + px * y - py * x + pz * w
    moved[6] = pw * w - px * x - py * y - pz * z
    length = math.sqrt(moved[3] ** 2 + moved[4] ** 2 + moved[5] ** 2 + moved[6] ** 2)
    for a in range(3, 7):
        moved[a] /= length


@njit(
    "i8(f8[::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[::1], f8, i8[::1], b1, i8, i4[::1], i8[::1],"
    " f8[::1], f8[:,::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def superpose(
    source: Array,
    source_centroids: Array,
    quaternions: Array,
    rotations: Array,
    translations: Array,
    reference: Array,
    pixel: float,
    shape: Keys,
    planar: bool,
    turns: int,
    slots: NDArray[np.int32],
    keys: Keys,
    counts: Array,
    centroids: Array,
) -> int:
    """Writes keys, counts and centroids of the source's points moved by every motion.

    A pixel's points move to where their centroid goes: the mean position, and the mean quaternion, signs agreed.

    Returns:
        the number of pixels, or -1 where there is no room for so many.
    """
    slots[:] = -1
    moved, used, mask = np.empty(7), 0, len(slots) - 1
    for j in range(len(rotations)):
        for n in range(len(source)):
            carry(source_centroids[n], quaternions[j], rotations[j], translations[j], moved)
            own = key(moved, reference, pixel, shape, planar, turns)
            slot = np.int64((np.uint64(own) * HASH) >> np.uint64(32)) & mask
            while slots[slot] >= 0 and keys[slots[slot]] != own:
                slot = (slot + 1) & mask
            k = slots[slot]
            if k < 0:
                if used == len(keys):
                    return -1
                slots[slot], k, used = used, used, used + 1
                keys[k], counts[k] = own, source[n]
                centroids[k] = moved
                continue
            counts[k] += source[n]
            share, c = source[n] / counts[k], centroids[k]
            agreed = share if c[3] * moved[3] + c[4] * moved[4] + c[5] * moved[5] + c[6] * moved[6] >= 0 else -share
            for a in range(3):
                c[a] += share * (moved[a] - c[a])
            for a in range(3, 7):
                c[a] += agreed * moved[a] - share * c[a]
    return used


@njit("UniTuple(f8[::1],2)(f8[:,::1], f8[:,:,::1], f8[:,::1])", cache=True, nogil=True)
def extent(centroids: Array, rotations: Array, translations: Array) -> tuple[Array, Array]:
    """Returns the least and greatest position of all centroids after every motion."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for n in range(len(centroids)):
        for j in range(len(rotations)):
            for a in range(3):
                p = translations[j, a]
                for b in range(3):
                    p += rotations[j, a, b] * centroids[n, b]
                low[a], high[a] = min(low[a], p), max(high[a], p)
    return low, high


@njit("void(f8[:,::1], f8[::1], f8, i8[::1], b1, i8, i8[::1])", cache=True, nogil=True)
def write_keys(
    frames: Array, reference: Array, pixel: float, shape: Keys, planar: bool, turns: int, keys: Keys
) -> None:
    """Writes the key of the pixel that each frame (n, 7) lies in, see key."""
    for n in range(len(frames)):
        keys[n] = key(frames[n], reference, pixel, shape, planar, turns)
