"""Joints of two or more positions, each with the link that follows it: turning and sliding.

The actuators 1, 2, ... spell the position's place in its list, counted from 0, in Gray code, the first the most
significant. A motor between neighbours so switches one actuator and can read nothing else on the way, even where its
inputs change one after the other, as those of drives with position tables may. On its way it is nowhere but between the
least and the greatest of the positions that may be read.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from controller.manipulator.frames import Frame, spatial, turned
from controller.manipulator.module import Array, Module, gray_code, lines, shares, spelled
from controller.manipulator.stroke_rates import joint_rates


def revolute(axis: ArrayLike, angles: Sequence[float], link: Frame) -> Module:
    """Returns a joint that turns about an axis (3,) to one of K angles [rad], and the link (4, 4) behind it."""
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    radius = float(np.linalg.norm(np.cross(unit, link[:3, 3])))
    return joint(lambda angle: turned(axis, angle), angles, link, radius, 1.0)


def prismatic(axis: ArrayLike, lengths: Sequence[float], link: Frame) -> Module:
    """Returns a joint that slides along an axis (3,) to one of K lengths, and the link (4, 4) behind it."""
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return joint(lambda length: spatial(length * unit), lengths, link, 1.0, 0.0)


def joint(position: Callable[[float], Frame], values: Sequence[float], link: Frame, move: float, turn: float) -> Module:
    """Returns the joint that has positions (4, 4) of these values; a unit of them moves and turns the frame so far."""
    stack, bits = np.array([position(value) for value in values]) @ link, gray_code(len(values))
    flat = bool((stack[:, 2] == [0.0, 0.0, 1.0, 0.0]).all())

    def motion(strokes: Array) -> tuple[Frame, Array]:
        frames = np.array([position(value) for value in shares(bits, strokes) @ values]) @ link
        return frames, lines(frames)

    rates = partial(joint_rates, bits, np.array(values, dtype=float), move, turn)
    return spelled(stack, bits, planar=flat, motion=motion, rates=rates)
