"""The Mapping Algorithm with orientation: the same recursion as in mapping, on R^2 x SO(2) or R^3 x SO(3).

Pixels carry the centroid of their points here, too, the mean position and the mean quaternion: both move by (R, b) as
the points do, so means stay true; what spread the points of one pixel have is lost at every level. Six dimensions leave
no room for boxes: levels are tables of the pixels that have points, and a pixel grows until they are few enough.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from controller.manipulator import frames
from controller.manipulator.manipulator import Manipulator
from controller.workspace.frame_pixels import SIDE, extent, superpose
from controller.workspace.mapping import grid, rescale
from controller.workspace.oriented import OrientedDensities

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
        weight: of rotations as a length, see frames.distance: a cell of the rotation measures at most pixel / weight.
        progress: called with the number of levels done so far, B+1 in all.

    Raises:
        ValueError: a bound or the weight is not positive, or a level has more pixels, with points or not, than there
            are keys.
    """
    if pixel <= 0 or level_pixels < 1 or weight <= 0:
        raise ValueError(
            f"pixel {pixel:g}, pixels per level {level_pixels} and weight of rotation {weight:g} must be positive"
        )
    planar, power = manipulator.planar, 1 if manipulator.planar else 3
    slots = np.empty(1 << (2 * level_pixels - 1).bit_length(), dtype=np.int32)
    keys = np.empty(level_pixels, dtype=np.int64)
    rooms = [(np.empty(level_pixels), np.empty((level_pixels, 7))) for _ in range(2)]  # source and target, in turns
    counts, centroids, exponent = np.ones(1), np.array([[0.0, 0, 0, 0, 0, 0, 1]]), 0
    shape, turns, reference = np.ones(3, dtype=np.int64), cells_along(pixel, weight, planar=planar), np.zeros(3)
    identity = np.array([0 if planar else turns**3 // 2])
    levels = [(identity, logarithms(counts, exponent), shape, reference, pixel, turns)]
    progress(1)
    for i in reversed(range(len(manipulator.modules))):
        rotations = manipulator.rotations[i, : manipulator.states[i]]
        translations = manipulator.translations[i, : manipulator.states[i]]
        quaternions = np.array([frames.quaternion(frame) for frame in manipulator.frames[i, : manipulator.states[i]]])
        low, high = extent(centroids, rotations, translations)
        used, finer = -1, pixel
        while used < 0:
            pixel, finer = finer, finer * GROWTH
            (nz, ny, nx), reference = grid(low, high, pixel)
            shape, turns = np.array((nz, ny, nx)), cells_along(pixel, weight, planar=planar)
            if int(nz) * int(ny) * int(nx) * turns**power >= 2**63:
                raise ValueError(f"pixel {pixel:g} with weight of rotation {weight:g} is too fine: keys have 63 bits")
            target = reference, pixel, shape, planar, turns
            used = superpose(
                counts, centroids, quaternions, rotations, translations, *target, slots, keys, *rooms[i % 2]
            )
        counts, centroids = (room[:used] for room in rooms[i % 2])
        exponent += rescale(counts)
        order = np.argsort(keys[:used])
        levels.append((keys[order], logarithms(counts[order], exponent), shape, reference, pixel, turns))
        progress(len(levels))
    levels.reverse()
    all_keys, values, shapes, references, pixels, turns_along = zip(*levels, strict=True)
    return OrientedDensities(
        keys=np.concatenate(all_keys),
        values=np.concatenate(values),
        offsets=np.cumsum([0] + [len(own) for own in all_keys]),
        shapes=np.array(shapes),
        references=np.array(references),
        pixels=np.array(pixels),
        turns=np.array(turns_along),
        planar=planar,
    )


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
