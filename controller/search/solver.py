"""Inverse kinematics of one goal, by any method."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.manipulator.frames import Frame, inverse
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search import criteria
from controller.search.candidates import Candidates
from controller.search.found import Found
from controller.search.method import Method
from controller.search.minimum_switch import MinimumSwitch
from controller.search.paths import Paths
from controller.search.reach import Reach
from controller.workspace.densities import Densities

Vector = NDArray[np.float64]

DEADLINE = 0.05  # [s]


@dataclass(frozen=True, eq=False)
class Solution:
    """What a search found for one goal.

    Attributes:
        configuration: module states, base first, shape (B,).
        tip: the frame it brings the tip to, in the world, shape (4, 4).
        error: distance of the tip from the goal.
        switches: actuators that differ from the previous configuration.
        within_tolerance: whether the error is within the tolerance asked for.
        seconds: time the search took.
        cost: weighted number of switches.
        lower_bound: no configuration within the tolerance costs less; infinite where there is proven to be none.
    """

    configuration: Configuration
    tip: Frame
    error: float
    switches: int
    within_tolerance: bool
    seconds: float
    cost: float
    lower_bound: float = 0.0

    @property
    def optimal(self) -> bool:
        """Whether it is proven that no configuration within the tolerance costs less."""
        return self.within_tolerance and self.lower_bound >= self.cost * (1 - 1e-9)  # sums of weights are rounded


class Solver:
    """Searches configurations of one manipulator; holds its tables, so that a goal costs microseconds.

    Attributes:
        manipulator: the arm.
        densities: of its intermediate workspaces.
        least_weight: of any actuator's switches.
    """

    def __init__(self, manipulator: Manipulator, densities: Densities, weights: ArrayLike | None = None) -> None:
        """Builds the tables of the paths.

        Args:
            manipulator: the arm.
            densities: of its intermediate workspaces.
            weights: of the actuators' switches, positive, shape (A,); all 1 if absent.
        """
        self.manipulator = manipulator
        self.densities = densities
        own = np.ones(len(manipulator.actuators)) if weights is None else np.asarray(weights, dtype=float)
        self._weights, self.least_weight = manipulator.per_module(own), float(own.min())
        self._paths = Paths(manipulator, densities)
        self._reach = Reach(manipulator)
        self._to_base = inverse(manipulator.base)
        self._candidates: tuple[int, Candidates] | None = None

    def prepare(self) -> None:
        """Claims the memory of the search for fewest switches, which the first searches would else wait for."""
        self._minimum.claim()

    def expect(self, previous: ArrayLike, tolerance: float) -> Iterator[None]:
        """Prepares the search for fewest switches from a configuration, step by step, before its goal is known.

        Args:
            previous: shape (B,).
            tolerance: that the goal is likely to have.
        """
        centre = np.asarray(previous, dtype=np.int64)
        costs = criteria.switching(self.manipulator, centre, self._weights)
        return self._minimum.expect(centre, costs, tolerance)

    def solve(
        self,
        goal: ArrayLike,
        previous: ArrayLike,
        tolerance: float,
        method: Method = "minimum-switch",
        deadline: float = DEADLINE,
    ) -> Solution:
        """Returns the configuration that a method takes for a goal.

        Args:
            goal: tip position in the world, shape (2,) or (3,).
            previous: configuration to stay close to, and to count switches from, shape (B,).
            tolerance: distance from the goal that is good enough.
            method: fewest switches, or the algorithm of section 3.2 and for IPOP the secondary criterion.
            deadline: time that the search for fewest switches may take [s]; it is never worse than IPOP.
        """
        began = time.perf_counter()
        chosen = np.asarray(previous, dtype=np.int64)
        world = self._world(goal)
        local = self._local(world)
        bound = 0.0
        if method in ("minimum-switch", "ipop-previous") and self._error(chosen, world) <= tolerance:
            best = chosen.copy()
        elif method == "minimum-switch":
            best, bound = self._fewest(local, world, chosen, tolerance, began + deadline)
        else:
            best = self._paths.follow(local, chosen, tolerance, method)
        return self.described(best, goal, chosen, tolerance, time.perf_counter() - began, bound)

    def described(
        self,
        configuration: Configuration,
        goal: ArrayLike,
        previous: Configuration,
        tolerance: float,
        seconds: float = 0.0,
        bound: float = 0.0,
    ) -> Solution:
        """Returns a configuration (B,) as the solution for a goal, whoever chose it."""
        tip = self.manipulator.tip(configuration)
        error = float(np.linalg.norm(tip[:3, 3] - self._world(goal)))
        return Solution(
            configuration=configuration,
            tip=tip,
            error=error,
            switches=self.manipulator.switches(configuration, previous),
            within_tolerance=error <= tolerance,
            seconds=seconds,
            cost=self._cost(configuration, previous),
            lower_bound=bound,
        )

    def candidates(
        self, goal: ArrayLike, previous: Configuration, tolerance: float, most: int
    ) -> tuple[NDArray[np.int64], Vector]:
        """Returns at most `most` of the cheapest configurations (n, B) within the tolerance, and their costs (n,).

        Only those that switch little are looked at; there may be none.
        """
        if self._candidates is None or self._candidates[0] != most:
            self._candidates = (most, Candidates(self.manipulator, most))
        costs = criteria.switching(self.manipulator, previous, self._weights)
        return self._candidates[1].find(self._local(self._world(goal)), previous, costs, tolerance)

    def _world(self, goal: ArrayLike) -> Vector:
        """Returns a goal of two or three coordinates with three."""
        given, world = np.asarray(goal, dtype=float), np.zeros(3)
        world[: len(given)] = given
        return world

    def _local(self, world: Vector) -> Vector:
        """Returns a point in the world (3,) in frame F_0."""
        return np.asarray(self._to_base[:3, :3] @ world + self._to_base[:3, 3])

    def _error(self, configuration: Configuration, world: Vector) -> float:
        """Returns the distance of a configuration's tip from a point in the world."""
        return float(np.linalg.norm(self.manipulator.tip(configuration)[:3, 3] - world))

    def _cost(self, configuration: Configuration, previous: Configuration) -> float:
        """Returns the weighted number of switches between two configurations."""
        own = self.manipulator.bits[np.arange(len(previous)), previous]
        new = self.manipulator.bits[np.arange(len(previous)), configuration]
        return float(((own != new) * self._weights).sum())

    def _fewest(
        self, goal: Vector, world: Vector, previous: Configuration, tolerance: float, until: float
    ) -> tuple[Configuration, float]:
        """Returns the cheapest configuration found, and the bound proven."""
        costs = criteria.switching(self.manipulator, previous, self._weights)
        worth = float(self._weights.sum() / len(self.manipulator.actuators))

        def first() -> Found:
            configuration = self._paths.follow(goal, previous, tolerance, "ipop-previous")
            error = self._error(configuration, world)
            cost = self._cost(configuration, previous) if error <= tolerance else np.inf
            return Found(configuration, cost, error**2)

        def widen(best: Found, width: int) -> Found:
            return self._paths.spread(goal, costs, tolerance, worth, width, best)

        found = self._minimum.improve(goal, previous, costs, tolerance, first, widen, until)
        return found.configuration, min(found.bound, found.cost)

    @cached_property
    def _minimum(self) -> MinimumSwitch:
        return MinimumSwitch(self.manipulator, self._reach)
