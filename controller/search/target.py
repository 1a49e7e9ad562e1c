"""The goal of a search, and the one definition of "within tolerance"."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import float64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.manipulator.frame_kernels import tip as tip_of
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.kernel_types import F2, F4, I1, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.scene import Scene

Array = NDArray[np.float64]

# Kernels round differently from `within`. They search with a slightly larger tolerance, and `within` decides. SLACK is
# the increase relative to the lengths involved, and the increase of the squared chord.
SLACK = 1e-11


class SearchQuery(NamedTuple):
    """A goal for kernels."""

    base: Array  # frame F_0 in the world, shape (4, 4)
    frames: Array  # configuration sets, shape (B, Kmax, 4, 4)
    goal: Array  # frame in the world, shape (4, 4)
    tolerance: float  # greatest distance
    angle_tolerance: float  # greatest angle [rad]; infinite without orientation
    radius: float  # search radius, slightly more than the tolerance
    chord: float  # greatest squared chord of the search, slightly more than that of the angle tolerance
    weight: float  # weight of rotations, see SearchTarget


QUERY = named(SearchQuery, F2, F4, F2, float64, float64, float64, float64, float64)


@dataclass(frozen=True, eq=False)
class SearchTarget:
    """The goal frame of a search, with its tolerances.

    The error of a tip is sqrt(|b - b'|^2 + (weight * chord)^2). The chord of the angle between two rotations is
    2 sin(angle / 2).
    """

    frame: Frame  # goal in frame F_0, shape (4, 4); its rotation has no meaning without orientation
    goal: Frame  # goal in the world, shape (4, 4)
    manipulator: Manipulator  # the arm
    tolerance: float  # greatest distance of the tip
    # greatest angle between the orientations of tip and goal [rad]; infinite without orientation
    angle_tolerance: float = math.inf
    weight: float = 0.0  # weight of rotations, a length; 0 without orientation
    scene: Scene | None = None  # obstacles, None if there are none

    @property
    def oriented(self) -> bool:
        """Whether the goal has an orientation."""
        return self.weight > 0

    @property
    def hard(self) -> bool:
        """Whether the goal has an orientation or obstacles; a configuration near the seed is then less likely."""
        return self.oriented or self.scene is not None

    @cached_property
    def row(self) -> Array:
        """The goal in frame F_0 as a row, see segment, shape (4,) or (12,)."""
        planar = self.manipulator.planar
        rotation = self.frame[:2, 0] if planar else self.frame[:3, :3].ravel()
        return np.concatenate((self.frame[: self.manipulator.dimension, 3], rotation))

    @property
    def position(self) -> Array:
        """Position in frame F_0, shape (3,)."""
        return np.ascontiguousarray(self.frame[:3, 3])

    @property
    def rotation(self) -> Array:
        """Rotation in frame F_0, shape (3, 3)."""
        return np.ascontiguousarray(self.frame[:3, :3])

    @property
    def share(self) -> float:
        """Share of all orientations that are within the tolerance."""
        angle = min(self.angle_tolerance, math.pi)
        return angle / math.pi if self.manipulator.planar else (angle - math.sin(angle)) / math.pi

    @property
    def exact_chord(self) -> float:
        """Squared chord of the angle tolerance; infinite without orientation."""
        return math.inf if self.angle_tolerance >= math.pi else (2 * math.sin(self.angle_tolerance / 2)) ** 2

    @property
    def chord(self) -> float:
        """Greatest squared chord of the search."""
        return self.exact_chord + SLACK

    @property
    def radius(self) -> float:
        """Greatest distance of the search."""
        return search_radius(self.manipulator, self.tolerance)

    @cached_property
    def query(self) -> SearchQuery:
        """The target for kernels."""
        m, goal = self.manipulator, np.ascontiguousarray(self.goal)
        angle = float(self.angle_tolerance) if self.oriented else math.inf
        tolerance, weight = float(self.tolerance), float(self.weight)
        return SearchQuery(m.base, m.frames, goal, tolerance, angle, float(self.radius), float(self.chord), weight)

    def squares(self, rows: Array) -> Array:
        """Returns the squared errors (n,) of tips, given as rows (n, 4 or 12) in frame F_0."""
        size = self.manipulator.dimension
        squares: Array = ((rows[:, :size] - self.row[:size]) ** 2).sum(axis=1)
        if self.oriented:
            chords = ((rows[:, size:] - self.row[size:]) ** 2).sum(axis=1) * (1.0 if size == 2 else 0.5)
            squares += self.weight**2 * chords
        return squares

    def square(self, tip: Frame) -> float:
        """Returns the squared error of a tip (4, 4) in the world."""
        return float(squared_error(tip, self.goal, float(self.weight)))

    def angle(self, tip: Frame) -> float:
        """Returns the angle [rad] between the orientations of a tip (4, 4) and the goal; 0 without orientation."""
        return float(angle_between(tip, self.goal)) if self.oriented else 0.0

    def met(self, configuration: Configuration) -> bool:
        """Returns whether the tip of a configuration (B,) is within both tolerances."""
        return self.met_by(self.manipulator.tip(configuration))

    def met_by(self, tip: Frame) -> bool:
        """Returns whether a tip (4, 4) in the world is within both tolerances."""
        angle = float(self.angle_tolerance) if self.oriented else math.inf
        return bool(within(tip, self.goal, float(self.tolerance), angle))


def search_radius(manipulator: Manipulator, tolerance: float) -> float:
    """Returns the search radius for a tolerance: slightly more, to cover rounding."""
    lengths = 2 * manipulator.length + float(np.abs(manipulator.base[:3, 3]).max())
    return tolerance + SLACK * (tolerance + lengths)


@kernel("f8(f8[:,:], f8[:,:])")
def distance(tip: Frame, goal: Frame) -> float:
    """Returns the distance between the positions of two frames (4, 4)."""
    x, y, z = tip[0, 3] - goal[0, 3], tip[1, 3] - goal[1, 3], tip[2, 3] - goal[2, 3]
    return math.sqrt(x * x + y * y + z * z)


@kernel("f8(f8[:,:], f8[:,:], f8)")
def squared_error(tip: Frame, goal: Frame, weight: float) -> float:
    """Returns the squared error of a tip (4, 4), by the weight of rotations, see SearchTarget."""
    square, chord = distance(tip, goal) ** 2, 0.0
    if weight > 0:
        for a in range(3):
            for b in range(3):
                chord += (tip[a, b] - goal[a, b]) ** 2
    return square + weight**2 * 0.5 * chord


@kernel("b1(f8[:,:], f8[:,:], f8, f8)")
def within(tip: Frame, goal: Frame, tolerance: float, angle_tolerance: float) -> bool:
    """Returns whether a tip (4, 4) is within the tolerances of a goal (4, 4): the one definition.

    Args:
        tip: frame in the world, from Manipulator.tip.
        goal: frame in the world.
        tolerance: greatest distance.
        angle_tolerance: greatest angle between the orientations [rad]; infinite without orientation.
    """
    if not distance(tip, goal) <= tolerance:  # a distance that is no number is not within
        return False
    return angle_tolerance == math.inf or angle_between(tip, goal) <= angle_tolerance


@kernel(types.boolean(QUERY, I1))
def reaches(query: SearchQuery, configuration: Configuration) -> bool:
    """Returns whether the tip of a configuration (B,) is within the tolerances of a query."""
    tip = tip_of(query.base, query.frames, configuration)
    return bool(within(tip, query.goal, query.tolerance, query.angle_tolerance))


@dataclass(frozen=True, eq=False)
class Problem:
    """A goal and the costs of configurations."""

    target: SearchTarget  # the goal
    seed: Configuration  # the configuration of cost 0, shape (B,)
    costs: Array  # cost of each module's states, at least 0, shape (B, Kmax)
    unreachable: bool = False  # whether the goal is known to be unreachable

    def cost(self, configuration: Configuration) -> float:
        """Returns the cost of a configuration (B,)."""
        return float(self.costs[np.arange(len(configuration)), configuration].sum())
