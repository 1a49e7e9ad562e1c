"""Frames as rows of numbers: (x, y, cos, sin) while the arm stays in the plane, (x, y, z, R row by row) elsewhere."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.manipulator.manipulator import Manipulator

Array = NDArray[np.float64]


def motions(manipulator: Manipulator) -> Array:
    """Returns the frames of every module's states as rows, module by module, shape (B * Kmax, 4) or (B * Kmax, 12)."""
    r, b = manipulator.rotations.reshape(-1, 3, 3), manipulator.translations.reshape(-1, 3)
    parts = (b[:, :2], r[:, :2, 0]) if manipulator.planar else (b, r.reshape(-1, 9))
    return np.concatenate(parts, axis=1)


def coordinates(frames: Array) -> int:
    """Returns how many coordinates a position has where frames are such rows (..., 4 or 12)."""
    return 2 if frames.shape[-1] == 4 else 3


# Rows are named by array and number in the two kernels that follow: slices would be counted references.
@njit("void(f8[:,::1], i8, f8[:,::1], i8, f8[:,::1], i8)", cache=True, nogil=True, inline="always")
def compose(a: Array, i: int, b: Array, j: int, out: Array, k: int) -> None:
    """Writes frame b[j] carried by frame a[i] to out[k], which is neither."""
    if out.shape[1] == 4:
        x, y, c, s = a[i, 0], a[i, 1], a[i, 2], a[i, 3]
        out[k, 0] = x + c * b[j, 0] - s * b[j, 1]
        out[k, 1] = y + s * b[j, 0] + c * b[j, 1]
        out[k, 2] = c * b[j, 2] - s * b[j, 3]
        out[k, 3] = s * b[j, 2] + c * b[j, 3]
    else:
        for m in range(3):
            p, q, r = a[i, 3 + 3 * m], a[i, 4 + 3 * m], a[i, 5 + 3 * m]
            out[k, m] = a[i, m] + p * b[j, 0] + q * b[j, 1] + r * b[j, 2]
            for n in range(3):
                out[k, 3 + 3 * m + n] = p * b[j, 3 + n] + q * b[j, 6 + n] + r * b[j, 9 + n]


@njit("void(f8[:,::1], i8, f8[:,::1], i8)", cache=True, nogil=True, inline="always")
def invert(a: Array, i: int, out: Array, k: int) -> None:
    """Writes the frame that leads back from a[i] to out[k], another."""
    if out.shape[1] == 4:
        x, y, c, s = a[i, 0], a[i, 1], a[i, 2], a[i, 3]
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = -c * x - s * y, s * x - c * y, c, -s
    else:
        for m in range(3):
            out[k, m] = -a[i, 3 + m] * a[i, 0] - a[i, 6 + m] * a[i, 1] - a[i, 9 + m] * a[i, 2]
            for n in range(3):
                out[k, 3 + 3 * m + n] = a[i, 3 + 3 * n + m]
