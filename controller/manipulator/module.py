"""A module: its configuration set C_i, and the actuator states of each configuration."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.manipulator.displacement_rates import blended_rates, corner_states
from hyperbit.controller.manipulator.frames import Frame, quaternion, spatial

Array = NDArray[np.float64]
Motion = Callable[[Array], tuple[Frame, Array]]
Rates = Callable[[Array, NDArray[np.int64]], Array]


@dataclass(frozen=True, eq=False)
class Module:
    """One module of the chain (section 2.1)."""

    frames: Frame  # the configuration set C_i: frame i in frame i-1 for each state, shape (K, 4, 4)
    bits: NDArray[np.uint8]  # actuator states (0 contracted, 1 extended) of each state, shape (K, A)
    actuators: tuple[str, ...]  # names of the actuators, in the order of the columns of `bits`
    # line segments of the module's structure in frame i-1, for each state, shape (K, L, 2, 3)
    body: NDArray[np.float64]
    planar: bool  # whether every frame stays in the plane z = 0
    # returns frames (n, 4, 4) and bodies (n, L, 2, 3) at displacements (n, A), each from 0 (contracted) to 1
    # (extended); NaN where the position is unknown. None: `blended` from the states around.
    motion: Motion | None = None
    # returns proven bounds (k, 3), see displacement_rates, from the displacements (A,) of the actuators that do not
    # move and the numbers (k,) of those that do. None: by `blended`, or unknown if `motion` is given.
    rates: Rates | None = None

    def between(self, displacements: Array) -> tuple[Frame, Array]:
        """Returns frames (n, 4, 4) and bodies (n, L, 2, 3) at displacements (n, A), see `motion`."""
        return blended(self, displacements) if self.motion is None else self.motion(displacements)

    @property
    def proven(self) -> bool:
        return self.rates is not None or self.motion is None

    def bounds(self, fixed: Array, moving: NDArray[np.int64]) -> Array:
        """Returns the proven bounds (k, 3) in mid-travel, see `rates`. Call only if `proven`."""
        if self.rates is not None:
            return self.rates(fixed, moving)
        if (states := corner_states(self.bits, fixed, moving)) is None:
            return np.full((len(moving), 3), np.inf)
        turns = np.array([quaternion(frame) for frame in self.frames[states]])
        return blended_rates(self.frames[states, :3, 3], turns, self.body[states])


def binary_code(states: int) -> NDArray[np.uint8]:
    """Returns the actuator states (states, A) of a binary code, most significant first, with the fewest actuators."""
    width = max(1, (states - 1).bit_length())
    shifts = np.arange(width - 1, -1, -1)
    return ((np.arange(states)[:, None] >> shifts) & 1).astype(np.uint8)


def gray_code(states: int) -> NDArray[np.uint8]:
    """Returns the actuator states (states, A) of the reflected Gray code: neighbours differ in one actuator."""
    bits = binary_code(states)
    bits[:, 1:] ^= bits[:, :-1].copy()
    return bits


def shares(bits: NDArray[np.uint8], displacements: Array) -> Array:
    """Returns the multilinear weights (n, K) of the codes (K, A) at displacements (n, A); each row sums to 1.

    A row is NaN if one of the codes around it has no state.
    """
    parts = np.where(bits == 1, displacements[:, None], 1.0 - displacements[:, None]).prod(axis=2)
    return np.where(abs(parts.sum(axis=1, keepdims=True) - 1.0) < 1e-9, parts, np.nan)


def blended(module: Module, displacements: Array) -> tuple[Frame, Array]:
    """Returns frames and bodies in mid-travel: positions are multilinear, rotations are nested slerps."""
    parts = shares(module.bits, displacements)
    frames = np.full((len(displacements), 4, 4), np.nan)
    quaternions = np.array([quaternion(frame) for frame in module.frames])
    known, travelling = np.isfinite(parts).all(axis=1), (displacements > 0) & (displacements < 1)
    for moving in np.unique(travelling[known], axis=0):
        rows, free = np.flatnonzero(known & (travelling == moving).all(axis=1)), np.flatnonzero(moving)
        corners = np.repeat(displacements[rows, None], 1 << len(free), axis=1)
        corners[:, :, free] = binary_code(1 << len(free))[:, : len(free)]
        turns = quaternions[(module.bits == corners[:, :, None]).all(axis=3).argmax(axis=2)]
        for a in free:
            first, second = np.split(turns, 2, axis=1)
            turns = midway(first, second, displacements[rows, None, None, a])
        frames[rows] = spatial(parts[rows] @ module.frames[:, :3, 3], turns[:, 0])
    return frames, np.tensordot(parts, module.body, 1)


def midway(first: Array, second: Array, share: Array) -> Array:
    """Returns the unit quaternions (..., 4) at shares (..., 1) of the shortest way from first to second (slerp)."""
    cosines = np.clip((first * second).sum(axis=-1, keepdims=True), -1.0, 1.0)
    angles, signs = np.arccos(abs(cosines)), np.where(cosines < 0, -1.0, 1.0)
    near, sines = angles < 1e-6, np.maximum(np.sin(angles), 1e-9)
    weights = np.where(near, 1.0 - share, np.sin((1.0 - share) * angles) / sines)
    others = np.where(near, share, np.sin(share * angles) / sines)
    return np.asarray(weights * first + others * signs * second)


def spelled(
    stack: Frame, bits: NDArray[np.uint8], *, planar: bool, motion: Motion | None = None, rates: Rates | None = None
) -> Module:
    """Returns the module of frames (K, 4, 4) with actuators 1, 2, ... in states (K, A); its body is one line."""
    names = tuple(str(k + 1) for k in range(bits.shape[1]))
    return Module(stack, bits, names, lines(stack), planar, motion, rates)


def lines(stack: Frame) -> Array:
    """Returns the bodies (n, 1, 2, 3) that are lines from the origin to frames (n, 4, 4)."""
    body = np.zeros((len(stack), 1, 2, 3))
    body[:, 0, 1] = stack[:, :3, 3]
    return body


def tipped(module: Module, tip: Frame) -> Module:
    """Returns a module whose frames are at the tip of a tool, `tip` (4, 4) in the module's own frames.

    The body has the tool, too: a line from the module's frame to the tip.
    """
    frames, body = with_tool(module.frames, module.body, tip)
    flat = module.planar and bool(np.allclose(tip[2], [0, 0, 1, 0]))
    rates = partial(tool_rates, module, tip) if module.proven else None
    return Module(frames, module.bits, module.actuators, body, flat, partial(tool_motion, module, tip), rates)


def with_tool(frames: Frame, body: Array, tip: Frame) -> tuple[Frame, Array]:
    """Returns frames (n, 4, 4) at the tip of a tool, and bodies (n, L + 1, 2, 3) with the tool."""
    tips = frames @ tip
    tool = np.stack([frames[:, :3, 3], tips[:, :3, 3]], axis=1)
    return tips, np.concatenate([body, tool[:, None]], axis=1)


def tool_motion(module: Module, tip: Frame, displacements: Array) -> tuple[Frame, Array]:
    """Returns frames and bodies of a module with a tool in mid-travel, see Module.motion."""
    return with_tool(*module.between(displacements), tip)


def tool_rates(module: Module, tip: Frame, fixed: Array, moving: NDArray[np.int64]) -> Array:
    """Returns proven bounds of a module with a tool, see Module.rates.

    At a distance d from the frame, the tip moves by at most d times the rotation more than the frame.
    """
    move, turn, body = module.bounds(fixed, moving).T
    length = float(np.linalg.norm(tip[:3, 3]))
    there = move + turn * length if length > 0 else move  # a rotation without a bound moves no tip at its centre
    return np.column_stack([there, turn, np.maximum(body, there)])


def transforms(frames: ArrayLike, *, planar: bool) -> Module:
    """Returns the module of frames (K, 4, 4); its actuators 1, 2, ... are the binary digits of the state."""
    stack = np.array(frames, dtype=float)
    return spelled(stack, binary_code(len(stack)), planar=planar)
