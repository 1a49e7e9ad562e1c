"""The density of an arm from those of its segments, one that comes again computed once: doubling, O(log B)."""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from controller.manipulator.frames import Frame
from controller.manipulator.manipulator import Manipulator

Density = TypeVar("Density")

ENUMERATED = 4096  # a segment of no more configurations is enumerated


def doubled(
    manipulator: Manipulator,
    short: Callable[[Manipulator], bool],
    begin: Callable[[Manipulator], Density],
    join: Callable[[Density, Density], Density],
) -> Density:
    """Returns the density of the whole arm's tips as seen from its base.

    Args:
        manipulator: the arm; its base frame plays no part.
        short: tells whether a segment is not to be halved; one module never is.
        begin: gives the density of such a segment.
        join: gives that of a lower segment (base side) and an upper one.
    """
    done: dict[tuple[bytes, ...], Density] = {}
    kinds = [module.frames.tobytes() for module in manipulator.modules]

    def density(first: int, last: int) -> Density:
        """Returns the density of modules first to last - 1."""
        kind = tuple(kinds[first:last])
        if kind not in done:
            segment, length = Manipulator(manipulator.modules[first:last]), last - first
            if length == 1 or short(segment):
                done[kind] = begin(segment)
            else:
                middle = first + (1 << (length - 1).bit_length() - 1)
                done[kind] = join(density(first, middle), density(middle, last))
        return done[kind]

    return density(0, len(kinds))


def few(manipulator: Manipulator) -> bool:
    """Tells whether an arm has so few configurations that they are enumerated."""
    return bool(math.prod(manipulator.states.tolist()) <= ENUMERATED)


def every_end(manipulator: Manipulator) -> Frame:
    """Returns the tips (n, 4, 4) of all configurations of a segment as seen from its base."""
    tips = np.eye(4)[None]
    for module in reversed(manipulator.modules):
        tips = (module.frames[:, None] @ tips).reshape(-1, 4, 4)
    return tips
