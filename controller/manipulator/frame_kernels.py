"""Kernels on frames. They are apart from `frames`, so that programs without kernels do not import numba."""

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.frames import Array

angle_between = kernel("f8(f8[:,:], f8[:,:])")(frames.angle_between)


@kernel("void(f8[:,::1], f8[::1])")
def set_identity(r: Array, b: Array) -> None:
    """Writes the identity as rotation (3, 3) and translation (3,).

    Kernels copy arrays element by element: numba compiles the assignment of an array to a slice for seconds.
    """
    for i in range(3):
        b[i] = 0.0
        for j in range(3):
            r[i, j] = 1.0 if i == j else 0.0


@kernel("void(f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1])", inline="always")
def compose(r: Array, b: Array, s: Array, c: Array, turned: Array, moved: Array) -> None:
    """Writes the product (R S, b + R c) of the frames (R, b) and (S, c). The output may be (R, b) itself."""
    for i in range(3):
        x, y, z = r[i, 0], r[i, 1], r[i, 2]
        moved[i] = b[i] + x * c[0] + y * c[1] + z * c[2]
        for j in range(3):
            turned[i, j] = x * s[0, j] + y * s[1, j] + z * s[2, j]


@kernel("f8[:,::1](f8[:,::1], f8[:,:,:,::1], i8[:])", boundscheck=True)
def tip(base: Array, frames: Array, configuration: NDArray[np.int64]) -> Array:
    """Returns the tip frame (4, 4) of a configuration (B,) from the base (4, 4) and the frames (B, Kmax, 4, 4)."""
    frame, following = base.copy(), np.empty((4, 4))
    for i in range(len(frames)):
        for a in range(4):
            for b in range(4):
                total = 0.0
                for c in range(4):
                    total += frame[a, c] * frames[i, configuration[i], c, b]
                following[a, b] = total
        frame, following = following, frame
    return frame


@kernel("f8[:,:,::1](f8[:,::1], f8[:,:,:,::1], i8[:,::1])", boundscheck=True)
def tips(base: Array, frames: Array, configurations: NDArray[np.int64]) -> Array:
    """Returns the tip frames (n, 4, 4) of configurations (n, B), see tip."""
    result = np.empty((len(configurations), 4, 4))
    for n in range(len(configurations)):
        frame = tip(base, frames, configurations[n])
        for a in range(4):
            for b in range(4):
                result[n, a, b] = frame[a, b]
    return result
