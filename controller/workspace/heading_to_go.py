"""Cost to go of the heading: the least cost with which the modules above a level turn the tip to a heading.

The recursion is that of the cost-to-go maps, on the circle. Headings are integers, so their sums are exact and wrap
around. The value of a bin is a lower bound for all its headings.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import int16, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import I1, named
from hyperbit.controller.manipulator.manipulator import Manipulator

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Levels = NDArray[np.int16]

BINS = 1 << 12
PART_BITS = 28  # bits of the parts of a bin; headings are counted in parts
PARTS = 1 << PART_BITS
CIRCLE = BINS * PARTS


class Headings(NamedTuple):
    """The costs to go of the heading."""

    turns: Integers  # rotation of each state in parts of the circle, shape (B * Kmax,)
    # cost by level and bin, shape (B + 1, BINS), in units of the maps; at least UNREACHABLE if no tip has the heading.
    # Shape (0, BINS) without orientation.
    values: Levels


HEADINGS = named(Headings, I1, int16[:, ::1])


def parts(sine: Array, cosine: Array) -> Integers:
    """Returns headings in parts of the circle."""
    return np.asarray(np.rint(np.arctan2(sine, cosine) * (CIRCLE / math.tau)), dtype=np.int64)


class HeadingToGo:
    """Computes the costs to go of the heading of one planar arm; owns their memory."""

    def __init__(self, manipulator: Manipulator) -> None:
        self._states = manipulator.states
        self._turns = parts(manipulator.rotations[:, :, 1, 0], manipulator.rotations[:, :, 0, 0])
        self._values = np.empty((len(self._states) + 1, BINS), dtype=np.int16)
        self._key: tuple[Levels, float] | None = None

    def headings(self, levels: Levels, unreachable: int, angle: float) -> Headings:
        """Returns the costs to go. Earlier ones become invalid.

        Args:
            levels: cost of each module's states in units, shape (B, Kmax).
            unreachable: value of headings that no tip has.
            angle: greatest angle between the headings of tip and goal [rad]; infinite without orientation.
        """
        turns = self._turns.ravel()
        if angle >= math.pi:
            return Headings(turns, self._values[:0])
        if self._key is None or self._key[1] != angle or not np.array_equal(self._key[0], levels):
            # Each rotation and the goal's heading are rounded by at most half a part.
            near = int(angle * (CIRCLE / math.tau)) + len(self._states) + 4
            write_headings(self._turns, self._states, levels, near, unreachable, self._values)
            self._key = levels.copy(), angle
        return Headings(turns, self._values)


@kernel(
    types.void(int64[:, ::1], int64[::1], int16[:, ::1], int64, int64, int16[:, ::1]),
    error_model="numpy",
)
def write_headings(
    turns: Integers, states: Integers, levels: Levels, near: int, unreachable: int, values: Levels
) -> None:
    """Computes the costs to go from the tip to the base.

    Args:
        turns: rotation of each state in parts of the circle, shape (B, Kmax).
        states: K_i, shape (B,).
        levels: cost of each module's states in units, shape (B, Kmax).
        near: greatest difference of headings at the tip, in parts of the circle.
        unreachable: value of headings that no tip has.
        values: written, shape (B + 1, BINS).
    """
    count, nothing = len(states), np.int16(unreachable)
    single, pair = np.empty(2 * BINS, dtype=np.int16), np.empty(2 * BINS, dtype=np.int16)
    for k in range(BINS):
        within = k * PARTS <= near or (k + 1) * PARTS > CIRCLE - near
        values[count, k] = np.int16(0) if within else nothing
    for level in range(count - 1, -1, -1):
        above, own = values[level + 1], values[level]
        for k in range(2 * BINS):  # two circles, so that no index wraps in the loop below
            here, before = above[k & (BINS - 1)], above[(k - 1) & (BINS - 1)]
            single[k], pair[k] = here, min(here, before)
        own[:] = nothing
        for j in range(states[level]):
            # A bin, turned back, covers one bin or parts of two.
            turn, price = turns[level, j] & (CIRCLE - 1), levels[level, j]
            source = single if turn % PARTS == 0 else pair
            start = BINS - turn // PARTS
            for k in range(BINS):
                own[k] = min(own[k], np.int16(source[start + k] + price))
