"""Poses of platforms whose geometry changes a little: led on from those known, and how they follow each number.

A leg's constraint holds before and after, so a pose moves by as much as makes up for what the constraint would miss:
no state need be led from the middle of all legs again, as it is when an arm is loaded.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from controller.calibration.parameters import Description
from controller.manipulator.frames import Frame
from controller.manipulator.module import binary_code
from controller.manipulator.platform import MANY, Legs, legs_of

Array = NDArray[np.float64]

NUDGE = 1e-6  # of the legs' middle length


def legs_and_lengths(entry: Description, size: float) -> tuple[Legs, Array]:
    """Returns the geometry and the legs' lengths of all states (K, L), in units of `size`."""
    legs = legs_of(entry["base"], entry["top"], size)
    return legs, np.array(entry["lengths"])[binary_code(2 ** len(legs.base))] / size


def scaled(stack: Frame, factor: float) -> Frame:
    """Returns frames (K, 4, 4) with lengths times a factor."""
    result = stack.copy()
    result[:, :3, 3] *= factor
    return result


def led_on(entry: Description, near: Frame) -> Frame:
    """Returns the poses (K, 4, 4) of a platform that Newton's steps find from those of one much like it.

    Raises:
        ValueError: a state has none.
    """
    size = sum(entry["lengths"]) / 2
    legs, lengths = legs_and_lengths(entry, size)
    found = [legs.settled(frame, own, MANY) for frame, own in zip(scaled(near, 1 / size), lengths, strict=True)]
    stack = [frame for frame in found if frame is not None]
    if len(stack) < len(found):
        raise ValueError("a platform's state has no assembly")
    return scaled(np.array(stack), size)


def followed(entry: Description, nudged: Callable[[float], Description], poses: Frame) -> Array:
    """Returns the derivatives (K, 4, 4) of a platform's poses by one number.

    Args:
        entry: the platform.
        nudged: returns it with that number changed by so much.
        poses: of its states, shape (K, 4, 4).
    """
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
