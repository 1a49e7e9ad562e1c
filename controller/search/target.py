"""What is asked of the tip: a position, or a pose, how near is near enough, and what is not to be touched."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.frames import Frame, angle_between
from controller.search.found import CLOSE
from controller.search.guard import Guard

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Target:
    """A frame that the tip is to come to.

    What misses it is compared by sqrt(|b - b'|^2 + (weight * chord)^2), the chord of the angle between the rotations
    being 2 sin(angle / 2).

    Attributes:
        frame: in frame F_0, shape (4, 4); its rotation is of no meaning where any will do.
        planar: whether the arm stays in the plane.
        tolerance: of the tip's distance.
        turn: of the angle between its orientation and the frame's [rad]; infinite where any will do.
        weight: of rotations, a length; 0 where any will do.
        guard: what the whole arm is to keep clear of on the way there, None if there is nothing.
    """

    frame: Frame
    planar: bool
    tolerance: float
    turn: float = math.inf
    weight: float = 0.0
    guard: Guard = None

    @property
    def oriented(self) -> bool:
        """Whether the rotation counts."""
        return self.weight > 0

    @property
    def hard(self) -> bool:
        """Whether more is asked than a position, so that what is near is not likely to serve."""
        return self.oriented or self.guard is not None

    @cached_property
    def row(self) -> Array:
        """The frame as a row of numbers, see frame_rows, shape (4,) or (12,)."""
        size = 2 if self.planar else 3
        rotation = self.frame[:2, 0] if self.planar else self.frame[:3, :3].ravel()
        return np.concatenate((self.frame[:size, 3], rotation))

    @property
    def position(self) -> Array:
        """Shape (3,)."""
        return np.ascontiguousarray(self.frame[:3, 3])

    @property
    def rotation(self) -> Array:
        """Shape (3, 3)."""
        return np.ascontiguousarray(self.frame[:3, :3])

    @property
    def share(self) -> float:
        """Which part of all orientations is within the tolerance."""
        angle = min(self.turn, math.pi)
        return angle / math.pi if self.planar else (angle - math.sin(angle)) / math.pi

    @property
    def limit(self) -> float:
        """Greatest squared chord of the rotations, infinite where any will do; as the tolerance, a little less."""
        return math.inf if self.turn >= math.pi else (2 * math.sin(self.turn * CLOSE / 2)) ** 2

    def square(self, tip: Frame) -> float:
        """Returns the square by which a tip (4, 4) misses the frame."""
        square = float(((tip[:3, 3] - self.frame[:3, 3]) ** 2).sum())
        if self.oriented:
            square += self.weight**2 * 0.5 * float(((tip[:3, :3] - self.frame[:3, :3]) ** 2).sum())
        return square

    def squares(self, rows: Array) -> Array:
        """Returns the squares (n,) by which tips, rows (n, 4 or 12), miss the frame."""
        size = 2 if self.planar else 3
        squares: Array = ((rows[:, :size] - self.row[:size]) ** 2).sum(axis=1)
        if self.oriented:
            chords = ((rows[:, size:] - self.row[size:]) ** 2).sum(axis=1) * (1.0 if self.planar else 0.5)
            squares += self.weight**2 * chords
        return squares

    def distance(self, tip: Frame) -> float:
        """Returns the distance of a tip (4, 4)."""
        return float(np.linalg.norm(tip[:3, 3] - self.frame[:3, 3]))

    def angle(self, tip: Frame) -> float:
        """Returns the angle [rad] between the orientation of a tip (4, 4) and the frame's; 0 where any will do."""
        return angle_between(tip, self.frame) if self.oriented else 0.0

    def met(self, tip: Frame) -> bool:
        """Returns whether a tip (4, 4) is within both tolerances."""
        return self.distance(tip) <= self.tolerance and self.angle(tip) <= self.turn
