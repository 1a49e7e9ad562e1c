"""The Mapping Algorithm with orientation: the same recursion as in mapping, on R^2 x SO(2) or R^3 x SO(3).

Pixels carry the centroid of their points here, too, the mean position and the mean quaternion: both move by (R, b) as
the points do, so means stay true; what spread the points of one pixel have is lost at every level. Six dimensions leave
no room for boxes: levels are tables of the pixels that have points, and a pixel grows until they are few enough.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.mapping import grid, rescale
from tests.benchmarks.search.oriented_densities.frame_pixels import SIDE, extent, superpose
from tests.benchmarks.search.oriented_densities.oriented import OrientedDensities

GROWTH = 1.1  # of the pixel's side, while a level has too many


def map_oriented(
    manipulator: Manipulator,
    pixel: float,
    level_pixels: int,
    weight: float,
    progress: Callable[[int], None] = lambda levels: None,
) -> OrientedDensities:
    """Returns the densities with orientation of all intermediate workspaces.

    Args:
        manipulator: the arm; its base frame plays no part.
        pixel: finest side of a pixel, in the arm's unit of length.
        level_pixels: most pixels of one level that have points, 12 bytes each (and some 170 more while mapping);
            a level that needs more gets coarser pixels.
        weight: of rotations as a length, see metric.distance: a cell of the rotation measures at most
            pixel / weight.
        progress: called with the number of levels done so far, B+1 in all.

    Raises:
        ValueError: a bound or the weight is not positive, or a level has more pixels, with points or not, than there
            are keys.
    """
    if pixel <= 0 or level_pixels < 1 or weight <= 0:
        raise ValueError(
            f"pixel {pixel:g}, pixels per level {level_pixels} and weight of rotation {weight:g} must be positive"
        )
    planar, identity = manipulator.planar, np.array([[0.0, 0, 0, 0, 0, 0, 1]])
    room = Room(level_pixels)
    shape, turns = np.ones(3, dtype=np.int64), cells_along(pixel, weight, planar=planar)
    key = np.array([0 if planar else turns**3 // 2])  # of the tip as seen from itself
    level = Level(key, np.ones(1), identity, 0, shape, np.zeros(3), pixel, turns)
    levels = [packed(level)]
    progress(1)
    for i in reversed(range(len(manipulator.modules))):
        level = below(level, manipulator.modules[i].frames, weight, room, planar=planar)
        levels.append(packed(level))
        progress(len(levels))
    levels.reverse()
    keys, values, shapes, references, pixels, turns_along = zip(*levels, strict=True)
    return OrientedDensities(
        keys=np.concatenate(keys),
        values=np.concatenate(values),
        offsets=np.cumsum([0] + [len(own) for own in keys]),
        shapes=np.array(shapes),
        references=np.array(references),
        pixels=np.array(pixels),
        turns=np.array(turns_along),
        planar=planar,
    )


class Room:
    """The arrays that levels are mapped in: the hash table, keys, and those of source and target, in turns."""

    def __init__(self, level_pixels: int) -> None:
        self.slots = np.empty(1 << (2 * level_pixels - 1).bit_length(), dtype=np.int32)
        self.keys = np.empty(level_pixels, dtype=np.int64)
        self.target = np.empty(level_pixels), np.empty((level_pixels, 7))
        self.other = np.empty(level_pixels), np.empty((level_pixels, 7))

    def turn(self) -> None:
        """Makes the source's arrays the next target's."""
        self.target, self.other = self.other, self.target


@dataclass(frozen=True, eq=False)
class Level:
    """One intermediate workspace while it is mapped: counts times two to `exponent`, in no order; views of a Room."""

    keys: NDArray[np.int64]
    counts: NDArray[np.float64]
    centroids: NDArray[np.float64]
    exponent: int
    shape: NDArray[np.int64]
    reference: NDArray[np.float64]
    pixel: float
    turns: int


def below(level: Level, motions: Frame, weight: float, room: Room, *, planar: bool) -> Level:
    """Returns the next level towards the base: the superposition of `level` moved by a module's frames (n, 4, 4)."""
    rotations, translations = (np.ascontiguousarray(part) for part in (motions[:, :3, :3], motions[:, :3, 3]))
    quaternions = np.array([frames.quaternion(frame) for frame in motions])
    low, high = extent(level.centroids, rotations, translations)
    used, pixel, finer = -1, level.pixel, level.pixel
    while used < 0:
        pixel, finer = finer, finer * GROWTH
        (nz, ny, nx), reference = grid(low, high, pixel)
        shape, turns = np.array((nz, ny, nx)), cells_along(pixel, weight, planar=planar)
        if int(nz) * int(ny) * int(nx) * turns ** (1 if planar else 3) >= 2**63:
            raise ValueError(f"pixel {pixel:g} with weight of rotation {weight:g} is too fine: keys have 63 bits")
        moved = level.counts, level.centroids, quaternions, rotations, translations
        target = reference, pixel, shape, planar, turns
        used = superpose(*moved, *target, room.slots, room.keys, *room.target)
    counts, centroids = (array[:used] for array in room.target)
    room.turn()
    exponent = level.exponent + rescale(counts)
    return Level(room.keys[:used], counts, centroids, exponent, shape, reference, pixel, turns)


Packed = tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64], NDArray[np.float64], float, int]


def packed(level: Level) -> Packed:
    """Returns keys, values, shape, reference, pixel and turns of a level as they are kept, keys in order."""
    order = np.argsort(level.keys)
    values = logarithms(level.counts[order], level.exponent)
    return level.keys[order], values, level.shape, level.reference, level.pixel, level.turns


def cells_along(pixel: float, weight: float, *, planar: bool) -> int:
    """Returns how many cells of a full turn, or along the cube of rotations, are fine enough.

    What is common lies in the middle of a cell: quarter turns of a planar arm, the identity of a spatial one.
    """
    if planar:
        needed = math.ceil(2 * math.pi * weight / pixel)
        return needed if needed == 1 else -(-needed // 4) * 4
    along: int = math.ceil(2 * SIDE * weight / pixel)
    return along | 1  # near the middle, half an angle is a length in the cube


def logarithms(counts: NDArray[np.float64], exponent: int) -> NDArray[np.float32]:
    """Returns ln of the counts times two to the exponent, at least 0 where rescaling kept a count at its floor."""
    return np.maximum(np.log(counts) + exponent * math.log(2.0), 0.0).astype(np.float32)
