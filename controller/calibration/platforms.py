"""Poses of platforms whose geometry changes slightly, with derivatives.

The constraints of the legs hold before and after a change (implicit function theorem). So a pose is tracked from the
known pose by Newton's method; the continuation from the middle of all legs is needed only when an arm is loaded.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.calibration.parameters import Description
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.module import binary_code
from hyperbit.controller.manipulator.platform import MANY, Legs, legs_of

Array = NDArray[np.float64]

NUDGE = 1e-6  # step of finite differences, as a share of the legs' middle length


def legs_and_lengths(entry: Description, size: float) -> tuple[Legs, Array]:
    """Returns the geometry, and the lengths (K, L) of the legs in all states, in units of `size`."""
    legs = legs_of(entry["base"], entry["top"], size)
    return legs, np.array(entry["lengths"])[binary_code(2 ** len(legs.base))] / size


def scaled(stack: Frame, factor: float) -> Frame:
    """Returns frames (K, 4, 4) with their positions times a factor."""
    result = stack.copy()
    result[:, :3, 3] *= factor
    return result


def tracked(entry: Description, near: Frame) -> Frame:
    """Returns poses (K, 4, 4) by Newton's method from similar poses. Raises ValueError if a state has none."""
    size = sum(entry["lengths"]) / 2
    legs, lengths = legs_and_lengths(entry, size)
    found = [legs.solve_pose(frame, own, MANY) for frame, own in zip(scaled(near, 1 / size), lengths, strict=True)]
    stack = [frame for frame in found if frame is not None]
    if len(stack) < len(found):
        raise ValueError("a platform's state has no assembly")
    return scaled(np.array(stack), size)


def pose_derivatives(entry: Description, nudged: Callable[[float], Description], poses: Frame) -> Array:
    """Returns the derivatives (K, 4, 4) of a platform's poses (K, 4, 4) by one number, which `nudged` changes."""
    size = sum(entry["lengths"]) / 2
    legs, lengths = legs_and_lengths(entry, size)
    (less, shorter), (more, longer) = (legs_and_lengths(nudged(sign * NUDGE * size), size) for sign in (-1, 1))
    frames = scaled(poses, 1 / size)
    missed = (more.misfit(frames, longer)[0] - less.misfit(frames, shorter)[0]) / (2 * NUDGE)
    twists, result = np.zeros((len(poses), 6)), np.zeros_like(poses)
    twists[:, legs.free] = np.linalg.solve(legs.misfit(frames, lengths)[1], -missed[..., None])[..., 0]
    axes = np.swapaxes(frames[:, :3, :3], 1, 2)
    result[:, :3, :3] = np.swapaxes(np.cross(twists[:, None, 3:], axes), 1, 2) / size
    result[:, :3, 3] = twists[:, :3]
    return result
