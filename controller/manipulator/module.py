"""A module: its configuration set C_i and the actuator states that bring each configuration about."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.manipulator.frames import Frame


@dataclass(frozen=True, eq=False)
class Module:
    """One module of the chain (section 2.1).

    Attributes:
        frames: the configuration set C_i, frame i in frame i-1 for each state, shape (K, 4, 4).
        bits: the actuator states (0 contracted, 1 extended) of each state, shape (K, A).
        actuators: the actuators' names, in the order of the columns of `bits`.
        body: line segments of the module's structure in frame i-1, for each state, shape (K, L, 2, 3).
        planar: whether every frame stays in the plane z = 0.
    """

    frames: Frame
    bits: NDArray[np.uint8]
    actuators: tuple[str, ...]
    body: NDArray[np.float64]
    planar: bool


def binary_code(states: int) -> NDArray[np.uint8]:
    """Returns the actuator states (states, A) that count in binary, most significant first, A as few as suffice."""
    width = max(1, (states - 1).bit_length())
    shifts = np.arange(width - 1, -1, -1)
    return ((np.arange(states)[:, None] >> shifts) & 1).astype(np.uint8)


def gray_code(states: int) -> NDArray[np.uint8]:
    """Returns the actuator states (states, A) in Gray's binary reflected code: neighbours differ in one actuator."""
    bits = binary_code(states)
    bits[:, 1:] ^= bits[:, :-1].copy()
    return bits


def spelled(stack: Frame, bits: NDArray[np.uint8], *, planar: bool) -> Module:
    """Returns the module whose states are frames (K, 4, 4), spelled by actuators 1, 2, ... (K, A); its body a line."""
    body = np.zeros((len(stack), 1, 2, 3))
    body[:, 0, 1] = stack[:, :3, 3]
    names = tuple(str(k + 1) for k in range(bits.shape[1]))
    return Module(stack, bits, names, body, planar)


def transforms(frames: ArrayLike, *, planar: bool) -> Module:
    """Returns the module whose states are frames (K, 4, 4); its actuators 1, 2, ... spell the state in binary."""
    stack = np.array(frames, dtype=float)
    return spelled(stack, binary_code(len(stack)), planar=planar)
