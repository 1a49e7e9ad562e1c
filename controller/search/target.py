"""What is asked of the tip, and the one definition of "within tolerance"."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import float64, njit, types
from numpy.typing import NDArray

from controller.manipulator.frames import Frame, angle_between
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.manipulator.manipulator import tip as tip_of
from controller.obstacles.scene import Scene
from controller.search.frame_rows import F2, F4, I1, named

Array = NDArray[np.float64]

# The search's arithmetic differs from that of `within` by rounding. So the search looks a little farther, and `within`
# decides. It looks farther by this part of the lengths involved, and by this much of a squared chord.
SLACK = 1e-11


class Query(NamedTuple):
    """A goal as kernels take it.

    Attributes:
        base: frame F_0 in the world, shape (4, 4).
        frames: configuration sets, shape (B, Kmax, 4, 4).
        goal: frame in the world, shape (4, 4).
        tolerance: of the distance.
        angle_tolerance: of the orientation [rad]; infinite if any orientation will do.
        radius: of the search, a little more than the tolerance.
        chord: greatest squared chord of the search, a little more than that of the angle tolerance.
        weight: of rotations, see Target.
    """

    base: Array
    frames: Array
    goal: Array
    tolerance: float
    angle_tolerance: float
    radius: float
    chord: float
    weight: float


QUERY = named(Query, F2, F4, F2, float64, float64, float64, float64, float64)


@dataclass(frozen=True, eq=False)
class Target:
    """A frame that the tip is to come to.

    The miss of a tip is sqrt(|b - b'|^2 + (weight * chord)^2). The chord of the angle between the rotations is
    2 sin(angle / 2).

    Attributes:
        frame: in frame F_0, shape (4, 4); its rotation has no meaning if any orientation will do.
        goal: the same frame in the world, shape (4, 4).
        manipulator: the arm.
        tolerance: of the tip's distance.
        turn: of the angle between its orientation and the frame's [rad]; infinite if any orientation will do.
        weight: of rotations, a length; 0 if any orientation will do.
        scene: obstacles, None if there are none.
    """

    frame: Frame
    goal: Frame
    manipulator: Manipulator
    tolerance: float
    turn: float = math.inf
    weight: float = 0.0
    scene: Scene | None = None

    @property
    def oriented(self) -> bool:
        """Whether the rotation counts."""
        return self.weight > 0

    @property
    def hard(self) -> bool:
        """Whether more is asked than a position, so that a configuration near the seed is less likely to serve."""
        return self.oriented or self.scene is not None

    @cached_property
    def row(self) -> Array:
        """The frame as a row of numbers, see frame_rows, shape (4,) or (12,)."""
        planar = self.manipulator.planar
        rotation = self.frame[:2, 0] if planar else self.frame[:3, :3].ravel()
        return np.concatenate((self.frame[: self.manipulator.dimension, 3], rotation))

    @property
    def position(self) -> Array:
        """In frame F_0, shape (3,)."""
        return np.ascontiguousarray(self.frame[:3, 3])

    @property
    def rotation(self) -> Array:
        """In frame F_0, shape (3, 3)."""
        return np.ascontiguousarray(self.frame[:3, :3])

    @property
    def share(self) -> float:
        """Which part of all orientations is within the tolerance."""
        angle = min(self.turn, math.pi)
        return angle / math.pi if self.manipulator.planar else (angle - math.sin(angle)) / math.pi

    @property
    def exact_chord(self) -> float:
        """Greatest squared chord of the rotations, infinite if any orientation will do."""
        return math.inf if self.turn >= math.pi else (2 * math.sin(self.turn / 2)) ** 2

    @property
    def chord(self) -> float:
        """Greatest squared chord of the rotations that the search looks at."""
        return self.exact_chord + SLACK

    @property
    def radius(self) -> float:
        """Greatest distance that the search looks at."""
        return search_radius(self.manipulator, self.tolerance)

    @cached_property
    def query(self) -> Query:
        """The target as kernels take it."""
        m, goal = self.manipulator, np.ascontiguousarray(self.goal)
        turn = self.turn if self.oriented else math.inf
        tolerance, weight = float(self.tolerance), float(self.weight)
        return Query(m.base, m.frames, goal, tolerance, float(turn), float(self.radius), float(self.chord), weight)

    def squares(self, rows: Array) -> Array:
        """Returns the squared misses (n,) of tips, rows (n, 4 or 12) in frame F_0."""
        size = self.manipulator.dimension
        squares: Array = ((rows[:, :size] - self.row[:size]) ** 2).sum(axis=1)
        if self.oriented:
            chords = ((rows[:, size:] - self.row[size:]) ** 2).sum(axis=1) * (1.0 if size == 2 else 0.5)
            squares += self.weight**2 * chords
        return squares

    def square(self, tip: Frame) -> float:
        """Returns the squared miss of a tip (4, 4) in the world."""
        square = distance(tip, self.goal) ** 2
        if self.oriented:
            square += self.weight**2 * 0.5 * float(((tip[:3, :3] - self.goal[:3, :3]) ** 2).sum())
        return square

    def angle(self, tip: Frame) -> float:
        """Returns the angle [rad] of a tip (4, 4) in the world from the goal's orientation; 0 if any will do."""
        return float(angle_between(tip, self.goal)) if self.oriented else 0.0

    def met(self, configuration: Configuration) -> bool:
        """Returns whether a configuration (B,) brings the tip within both tolerances."""
        return bool(reaches(self.query, np.ascontiguousarray(configuration, dtype=np.int64)))


def search_radius(manipulator: Manipulator, tolerance: float) -> float:
    """Returns the distance from a goal within which to look for tips that may be within a tolerance."""
    lengths = 2 * manipulator.length + float(np.abs(manipulator.base[:3, 3]).max())
    return tolerance + SLACK * (tolerance + lengths)


@njit("f8(f8[:,:], f8[:,:])", cache=True, nogil=True)
def distance(tip: Frame, goal: Frame) -> float:
    """Returns the distance of two frames' (4, 4) positions."""
    x, y, z = tip[0, 3] - goal[0, 3], tip[1, 3] - goal[1, 3], tip[2, 3] - goal[2, 3]
    return math.sqrt(x * x + y * y + z * z)


@njit("b1(f8[:,:], f8[:,:], f8, f8)", cache=True, nogil=True)
def within(tip: Frame, goal: Frame, tolerance: float, angle_tolerance: float) -> bool:
    """Returns whether a tip (4, 4) is within the tolerances of a goal (4, 4): the definition for search and answers.

    Args:
        tip: frame in the world, as Manipulator.tip computes it.
        goal: frame in the world.
        tolerance: of the distance.
        angle_tolerance: of the orientation [rad]; infinite if any orientation will do.
    """
    if distance(tip, goal) > tolerance:
        return False
    return angle_tolerance == math.inf or angle_between(tip, goal) <= angle_tolerance


@njit(types.boolean(QUERY, I1), cache=True, nogil=True)
def reaches(query: Query, configuration: Configuration) -> bool:
    """Returns whether a configuration (B,) brings the tip within the tolerances of a query."""
    tip = tip_of(query.base, query.frames, configuration)
    return bool(within(tip, query.goal, query.tolerance, query.angle_tolerance))
