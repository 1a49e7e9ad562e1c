"""A planar arm as arrays for the kernels of the compared methods: motions of points, and numbers of switches."""

from typing import NamedTuple

import numpy as np
from numba import int64
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F3, I1, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Planar(NamedTuple):
    """The arm. A motion (c, s, x, y) maps a point to (c px - s py + x, s px + c py + y)."""

    states: Index  # K_i, shape (B,)
    up: Array  # motion from frame i to frame i-1, for each state, shape (B, K, 4)
    down: Array  # motion from frame i-1 to frame i, for each state, shape (B, K, 4)
    differing: Index  # actuators that differ between two states of a module, shape (B, K, K)

    def costs(self, previous: Configuration) -> Index:
        """Switches to each state of each module from a configuration, shape (B, K)."""
        return np.ascontiguousarray(self.differing[np.arange(len(self.states)), previous])


PLANAR = named(Planar, I1, F3, F3, int64[:, :, ::1])


def planar(manipulator: Manipulator) -> Planar:
    """Returns the arrays of a planar arm with its base at the origin."""
    if not manipulator.planar or not np.allclose(manipulator.base, np.eye(4)):
        raise ValueError("the compared methods take planar arms with the base at the origin")
    c, s = manipulator.rotations[..., 0, 0], manipulator.rotations[..., 1, 0]
    x, y = manipulator.translations[..., 0], manipulator.translations[..., 1]
    return Planar(
        manipulator.states,
        np.stack((c, s, x, y), axis=-1),
        np.stack((c, -s, -(c * x + s * y), s * x - c * y), axis=-1),
        (manipulator.bits[:, :, None] != manipulator.bits[:, None]).sum(axis=3),
    )


@kernel("UniTuple(f8, 2)(f8[::1], f8, f8)", inline="always")
def moved(motion: Array, x: float, y: float) -> tuple[float, float]:
    """Returns the image of a point under a motion."""
    return motion[0] * x - motion[1] * y + motion[2], motion[1] * x + motion[0] * y + motion[3]


@kernel("void(f8[:,:,::1], i8[::1], f8[:,::1])")
def tips_above(up: Array, configuration: Index, out: Array) -> None:
    """Writes the tip's position in each frame F_0 to F_B, shape (B+1, 2)."""
    x, y = 0.0, 0.0
    out[len(configuration)] = 0.0
    for i in range(len(configuration) - 1, -1, -1):
        x, y = moved(up[i, configuration[i]], x, y)
        out[i, 0], out[i, 1] = x, y
