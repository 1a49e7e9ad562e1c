"""The measure of reachability of a point (section 3.1.2), by the densities."""

from typing import Any, NamedTuple

import numpy as np
from numba import float32, float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, F4, I1, I2, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.densities import Densities

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class ReachTables(NamedTuple):
    """Configuration sets of an arm."""

    rotations: Array  # shape (B, Kmax, 3, 3)
    translations: Array  # shape (B, Kmax, 3)
    states: Index  # K_i, shape (B,)


class Levels(NamedTuple):
    """The arrays of Densities."""

    values: NDArray[np.float32]
    offsets: Index
    shapes: Index
    references: Array
    pixels: Array


TABLES = named(ReachTables, F4, F3, I1)
POINT: Any = types.UniTuple(float64, 3)  # type: ignore[no-untyped-call]
LEVELS = named(Levels, float32[::1], I1, I2, F2, F1)


def tables_of(manipulator: Manipulator) -> ReachTables:
    return ReachTables(manipulator.rotations, manipulator.translations, manipulator.states)


def levels_of(densities: Densities) -> Levels:
    return Levels(densities.values, densities.offsets, densities.shapes, densities.references, densities.pixels)


@kernel(float64(LEVELS, int64, float64, float64, float64), **UNCOUNTED, error_model="numpy")
def measure(levels: Levels, i: int, x: float, y: float, z: float) -> float:
    """Returns the measure of reachability of a point (x, y, z) in intermediate workspace i.

    The measure is the value of the point's pixel (see Densities): ln of the number of configurations that end there, or
    minus the distance to the nearest pixel with points. Outside the box the distance to the box is subtracted.
    """
    reference, pixel = levels.references[i], levels.pixels[i]
    nx, ny, nz = levels.shapes[i, 2], levels.shapes[i, 1], levels.shapes[i, 0]
    fx, fy, fz = (x - reference[0]) / pixel, (y - reference[1]) / pixel, (z - reference[2]) / pixel
    ix = min(max(int(np.floor(fx + 0.5)), 0), nx - 1)
    iy = min(max(int(np.floor(fy + 0.5)), 0), ny - 1)
    iz = min(max(int(np.floor(fz + 0.5)), 0), nz - 1)
    value = float(levels.values[levels.offsets[i] + (iz * ny + iy) * nx + ix])
    outside = max(abs(fx - ix), abs(fy - iy), abs(fz - iz))
    if outside > 0.51:
        dx, dy, dz = fx - ix, fy - iy, fz - iz
        value = min(value, 0.0) - pixel * np.sqrt(dx * dx + dy * dy + dz * dz)
    return value


@kernel([POINT(F2, F1, float64, float64, float64)], **UNCOUNTED, inline="always")
def seen_from(r: Array, b: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Returns a point (x, y, z) in a frame with rotation r (3, 3) and position b (3,)."""
    dx, dy, dz = x - b[0], y - b[1], z - b[2]
    return (
        r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz,
        r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz,
        r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz,
    )
