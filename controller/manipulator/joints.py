"""Joints of two or more positions, each with the link that follows it: turning and sliding.

The actuators 1, 2, ... spell the position's place in its list, counted from 0, in Gray code, the first the most
significant. A motor between neighbours so switches one actuator and can read nothing else on the way, even where its
inputs change one after the other, as those of drives with position tables may.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from controller.manipulator.frames import Frame, spatial, turned
from controller.manipulator.module import Module, gray_code, spelled


def revolute(axis: ArrayLike, angles: Sequence[float], link: Frame) -> Module:
    """Returns a joint that turns about an axis (3,) to one of K angles [rad], and the link (4, 4) behind it."""
    return joint([turned(axis, angle) for angle in angles], link)


def prismatic(axis: ArrayLike, lengths: Sequence[float], link: Frame) -> Module:
    """Returns a joint that slides along an axis (3,) to one of K lengths, and the link (4, 4) behind it."""
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return joint([spatial(length * unit) for length in lengths], link)


def joint(positions: Sequence[Frame], link: Frame) -> Module:
    """Returns the joint that has these positions (4, 4)."""
    stack = np.array(positions) @ link
    flat = bool((stack[:, 2] == [0.0, 0.0, 1.0, 0.0]).all())
    return spelled(stack, gray_code(len(stack)), planar=flat)
