"""A metric of frames, whose angles weigh as lengths."""

import math

from hyperbit.controller.manipulator.frames import Frame, angle_between


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
