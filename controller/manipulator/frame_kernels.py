"""Kernels on frames. They are apart from `frames`, so that what needs no kernel does not import numba."""

import math

from numba import njit

from controller.manipulator import frames
from controller.manipulator.frames import Array, Frame

angle_between = njit("f8(f8[:,:], f8[:,:])", cache=True, nogil=True)(frames.angle_between)


@njit("void(f8[:,::1], f8[::1])", cache=True, nogil=True)
def set_identity(r: Array, b: Array) -> None:
    """Writes the identity as rotation (3, 3) and translation (3,).

    Kernels copy arrays element by element: numba compiles the assignment of an array to a slice for seconds.
    """
    for i in range(3):
        b[i] = 0.0
        for j in range(3):
            r[i, j] = 1.0 if i == j else 0.0


@njit("void(f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1])", cache=True, nogil=True, inline="always")
def compose(r: Array, b: Array, s: Array, c: Array, turned: Array, moved: Array) -> None:
    """Writes the product (R S, b + R c) of the frames (R, b) and (S, c). The output may be (R, b) itself."""
    for i in range(3):
        x, y, z = r[i, 0], r[i, 1], r[i, 2]
        moved[i] = b[i] + x * c[0] + y * c[1] + z * c[2]
        for j in range(3):
            turned[i, j] = x * s[0, j] + y * s[1, j] + z * s[2, j]


@njit("f8(f8[:,:], f8[:,:], f8)", cache=True, nogil=True)
def distance(first: Frame, second: Frame, weight: float) -> float:
    """Returns the distance of two frames (4, 4): sqrt(|b - b'|^2 + (weight * angle between them)^2).

    The metric does not depend on the base frame (Park 1995, Distance metrics on the rigid-body motions with
    applications to mechanism design). A point at distance `weight` from the axis moves by weight * angle.

    Args:
        first: a frame.
        second: another frame.
        weight: weight of the rotation, a length; 0 compares positions only.
    """
    square = 0.0
    for a in range(3):
        square += (first[a, 3] - second[a, 3]) ** 2
    return math.sqrt(square + (weight * angle_between(first, second)) ** 2)
