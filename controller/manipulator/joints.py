"""Revolute and prismatic joints with two or more positions, each followed by a link.

The actuators 1, 2, ... are the digits of the position's number in Gray code, most significant first. A move to the next
position switches one actuator. So a drive with a position table reads no other position on the way, even if its inputs
change one after the other. In mid-travel the joint is between the least and the greatest position that may be read.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.manipulator.displacement_rates import joint_rates
from hyperbit.controller.manipulator.frames import Frame, spatial, turned
from hyperbit.controller.manipulator.module import Array, Module, binary_code, gray_code, lines, shares, spelled


def revolute(
    axis: ArrayLike, angles: Sequence[float] | Array, link: Frame, bits: NDArray[np.uint8] | None = None
) -> Module:
    """Returns a joint that turns about an axis (3,) to one of K angles [rad], followed by a link (4, 4).

    `bits`: actuator states (K, A) of the angles; None: Gray code.
    """
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    radius = float(np.linalg.norm(np.cross(unit, link[:3, 3])))
    return joint(partial(turned, axis), angles, link, radius, 1.0, gray_code(len(angles)) if bits is None else bits)


def prismatic(
    axis: ArrayLike, lengths: Sequence[float] | Array, link: Frame, bits: NDArray[np.uint8] | None = None
) -> Module:
    """Returns a joint that slides along an axis (3,) to one of K lengths, followed by a link (4, 4); see revolute."""
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return joint(partial(slid, unit), lengths, link, 1.0, 0.0, gray_code(len(lengths)) if bits is None else bits)


def summed(cylinders: Sequence[tuple[float, float]]) -> Array:
    """Returns the sums (2^n,), in binary code, of n cylinders in series, each with a value contracted and extended."""
    pairs = np.array(cylinders, dtype=float)
    return np.asarray(pairs[:, 0].sum() + binary_code(1 << len(pairs)) @ (pairs[:, 1] - pairs[:, 0]))


def joint(
    position: Callable[[float], Frame],
    values: Sequence[float] | Array,
    link: Frame,
    move: float,
    turn: float,
    bits: NDArray[np.uint8],
) -> Module:
    """Returns the joint of K positions.

    Args:
        position: returns the frame (4, 4) of a value.
        values: angle [rad] or length of each position.
        link: frame behind the joint, shape (4, 4).
        move: translation of the frame above for a unit of the value.
        turn: rotation of the frame above for a unit of the value [rad].
        bits: actuator states of each position, shape (K, A).
    """
    stack = np.array([position(value) for value in values]) @ link
    flat = bool((stack[:, 2] == [0.0, 0.0, 1.0, 0.0]).all())
    motion = partial(joint_motion, position, np.array(values, dtype=float), link, bits)
    rates = partial(joint_rates, bits, np.array(values, dtype=float), move, turn)
    return spelled(stack, bits, planar=flat, motion=motion, rates=rates)


def slid(unit: Array, length: float) -> Frame:
    """Returns the frame (4, 4) slid by a length along a unit vector (3,)."""
    return spatial(length * unit)


def joint_motion(
    position: Callable[[float], Frame],
    values: Array,
    link: Frame,
    bits: NDArray[np.uint8],
    displacements: Array,
) -> tuple[Frame, Array]:
    """Returns frames and bodies of a joint in mid-travel, see Module.motion; for the arguments see joint."""
    frames = np.reshape([position(value) for value in shares(bits, displacements) @ values], (-1, 4, 4)) @ link
    return frames, lines(frames)
