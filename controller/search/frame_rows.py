"""Frames as rows of numbers: (x, y, cos, sin) for planar arms, (x, y, z, R row by row) for spatial arms."""

from typing import NamedTuple

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, S1, named
from hyperbit.controller.manipulator.manipulator import Manipulator

Array = NDArray[np.float64]
Index32 = NDArray[np.int32]


class Side(NamedTuple):
    """Configurations of one segment of the arm, modules first+1 to last, for kernels."""

    frames: Array  # frames to compare, shape (n, 4) or (n, 12)
    costs: Array  # shape (n,)
    rows: NDArray[np.int64]  # row of each configuration in the segment, shape (n,)
    first: int  # number of modules below the segment
    last: int  # number of modules up to its end
    parents: Index32  # see Segment
    modules: Index32  # see Segment
    choices: Index32  # see Segment


SIDE = named(Side, F2, F1, I1, int64, int64, S1, S1, S1)
NO_ROWS = np.zeros(1, dtype=np.int32)


def fixed(frame: Array) -> Side:
    """Returns the side of a single frame (4,) or (12,) without modules, such as the goal."""
    return Side(frame[None].copy(), np.zeros(1), np.zeros(1, dtype=np.int64), 0, 0, NO_ROWS, NO_ROWS, NO_ROWS)


def motions(manipulator: Manipulator) -> Array:
    """Returns the frames of all states as rows, module by module, shape (B * Kmax, 4) or (B * Kmax, 12)."""
    r, b = manipulator.rotations.reshape(-1, 3, 3), manipulator.translations.reshape(-1, 3)
    parts = (b[:, :2], r[:, :2, 0]) if manipulator.planar else (b, r.reshape(-1, 9))
    return np.concatenate(parts, axis=1)


def coordinates(frames: Array) -> int:
    """Returns the number of coordinates of a position for frames as rows (..., 4 or 12)."""
    return 2 if frames.shape[-1] == 4 else 3


# The next two kernels take array and row number: numba would count references of slices.
@njit("void(f8[:,::1], i8, f8[:,::1], i8, f8[:,::1], i8)", cache=True, nogil=True, inline="always")
def compose(a: Array, i: int, b: Array, j: int, out: Array, k: int) -> None:
    """Writes the product of frames a[i] and b[j] to out[k], which must be another row."""
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
    """Writes the inverse of frame a[i] to out[k], which must be another row."""
    if out.shape[1] == 4:
        x, y, c, s = a[i, 0], a[i, 1], a[i, 2], a[i, 3]
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = -c * x - s * y, s * x - c * y, c, -s
    else:
        for m in range(3):
            out[k, m] = -a[i, 3 + m] * a[i, 0] - a[i, 6 + m] * a[i, 1] - a[i, 9 + m] * a[i, 2]
            for n in range(3):
                out[k, 3 + 3 * m + n] = a[i, 3 + 3 * n + m]


@njit("void(f8[:,::1], f8[:,::1], f8[:,::1])", cache=True, nogil=True, fastmath={"contract"})
def compose_all(frames: Array, frame: Array, out: Array) -> None:
    """Writes the products of frames (n, 4 or 12) and frame[0] to `out`."""
    for n in range(len(frames)):
        compose(frames, n, frame, 0, out, n)


@njit("void(f8[:,::1])", cache=True, nogil=True)
def invert_all(frames: Array) -> None:
    """Replaces frames (n, 4 or 12) by their inverses."""
    other = np.empty((1, frames.shape[1]))
    for n in range(len(frames)):
        invert(frames, n, other, 0)
        for a in range(frames.shape[1]):
            frames[n, a] = other[0, a]
