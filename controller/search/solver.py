"""Inverse kinematics of one goal, by any method."""

import math
import time
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.manipulator.frames import inverse
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.clearance import Clearance
from controller.search import criteria
from controller.search.candidates import Candidates
from controller.search.found import Found
from controller.search.guard import buried, guard_of
from controller.search.method import Method
from controller.search.minimum_switch import MinimumSwitch
from controller.search.paths import Paths
from controller.search.reach import build_reach
from controller.search.solution import Solution
from controller.search.target import Target
from controller.workspace.densities import Densities

Vector = NDArray[np.float64]

DEADLINE = 0.05  # [s]
PATIENCE = 0.5  # [s] for an orientation that is not found sooner


class Solver:
    """Searches configurations of one manipulator; holds its tables, so that a goal costs microseconds.

    Attributes:
        manipulator: the arm.
        densities: of its intermediate workspaces.
        least_weight: of any actuator's switches.
        clearance: what configurations keep clear of; None if nothing.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        densities: Densities,
        weights: ArrayLike | None = None,
        clearance: Clearance | None = None,
    ) -> None:
        """Builds the tables of the paths.

        Args:
            manipulator: the arm.
            densities: of its intermediate workspaces.
            weights: of the actuators' switches, positive, shape (A,); all 1 if absent.
            clearance: of this arm; configurations found keep clear, wherever the arm stands before.
        """
        self.manipulator = manipulator
        self.clearance, self._guard = clearance, guard_of(manipulator, clearance)
        self.densities = densities
        own = np.ones(len(manipulator.actuators)) if weights is None else np.asarray(weights, dtype=float)
        self._weights, self.least_weight = manipulator.per_module(own), float(own.min())
        self._paths = Paths(manipulator, densities)
        self._reach = build_reach(manipulator)
        self._to_base = inverse(manipulator.base)
        self._candidates: tuple[int, Candidates] | None = None

    def avoiding(self, clearance: Clearance | None) -> "Solver":
        """Returns a solver that keeps clear of something else, or of nothing.

        It shares the tables and the memory of this one: only one of them may search at a time.
        """
        other = copy(self)
        other.clearance, other._guard = clearance, guard_of(self.manipulator, clearance)
        return other

    def another(self) -> "Solver":
        """Returns a solver with the same tables and memory of its own: both may search at the same time."""
        other = copy(self)
        vars(other).pop("_minimum", None)
        other._candidates = None
        return other

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
        turn: float = math.inf,
        patience: float = PATIENCE,
    ) -> Solution:
        """Returns the configuration that a method takes for a goal.

        Args:
            goal: tip position in the world, shape (2,) or (3,), or the tip's frame, shape (4, 4).
            previous: configuration to stay close to, and to count switches from, shape (B,).
            tolerance: distance from the goal that is good enough.
            method: fewest switches, or the algorithm of section 3.2 and for IPOP the secondary criterion.
            deadline: time that the search for fewest switches may take [s]; it is never worse than IPOP.
            turn: angle from the goal's orientation that is good enough [rad]; infinite where any will do.
            patience: time in all for a goal with orientation, or among regions, that is not reached within the
                deadline [s].
        """
        began = time.perf_counter()
        chosen = np.asarray(previous, dtype=np.int64)
        world = self._target(goal, tolerance, turn)
        bound = 0.0
        if method in ("minimum-switch", "ipop-previous") and self._served(world, chosen):
            best = chosen.copy()
        elif method == "minimum-switch":
            latest = began + (max(deadline, patience) if world.hard else deadline)
            best, bound = self._fewest(world, chosen, began + deadline, latest)
        else:
            best = self._paths.follow(self._local(world), chosen, method)
            if world.hard and not self._served(world, best) and not self._hopeless(world):
                best = self._minimum.reach(self._local(world), best, began + patience)  # densities know positions only
        return self._described(best, world, chosen, time.perf_counter() - began, bound)

    def described(
        self,
        configuration: Configuration,
        goal: ArrayLike,
        previous: Configuration,
        tolerance: float,
        turn: float = math.inf,
    ) -> Solution:
        """Returns a configuration (B,) as the solution for a goal, whoever chose it."""
        return self._described(configuration, self._target(goal, tolerance, turn), previous)

    def candidates(
        self, goal: ArrayLike, previous: Configuration, tolerance: float, most: int, turn: float = math.inf
    ) -> tuple[NDArray[np.int64], Vector]:
        """Returns at most `most` of the cheapest configurations (n, B) within the tolerances, and their costs (n,).

        Only those that switch little are looked at; there may be none.
        """
        if self._candidates is None or self._candidates[0] != most:
            self._candidates = (most, Candidates(self.manipulator, most))
        costs = criteria.switching(self.manipulator, previous, self._weights)
        return self._candidates[1].find(self._local(self._target(goal, tolerance, turn)), previous, costs)

    def _described(
        self,
        configuration: Configuration,
        world: Target,
        previous: Configuration,
        seconds: float = 0.0,
        bound: float = 0.0,
    ) -> Solution:
        tip, clear = self.manipulator.tip(configuration), self._clear(configuration)
        return Solution(
            configuration=configuration,
            tip=tip,
            error=world.distance(tip),
            switches=self.manipulator.switches(configuration, previous),
            within_tolerance=clear and world.met(tip),
            seconds=seconds,
            cost=self._cost(configuration, previous),
            lower_bound=bound,
            angle=world.angle(tip),
            clear=clear,
        )

    def _served(self, world: Target, configuration: Configuration) -> bool:
        """Returns whether a configuration is within the tolerances, and clear."""
        return world.met(self.manipulator.tip(configuration)) and self._clear(configuration)

    def _hopeless(self, world: Target) -> bool:
        """Returns whether regions lie so around the goal that no clear tip can come within the tolerance."""
        return buried(self.clearance, world.position, world.tolerance)

    def _clear(self, configuration: Configuration) -> bool:
        return self.clearance is None or not self.clearance.blocked(configuration[None])[0]

    def _target(self, goal: ArrayLike, tolerance: float, turn: float) -> Target:
        """Returns what a goal asks for, in the world; see solve."""
        given, frame = np.asarray(goal, dtype=float), np.eye(4)
        if given.ndim == 2:
            frame = given
        else:
            frame[: len(given), 3] = given
        weight = tolerance / turn if turn < math.pi else 0.0  # so that both tolerances count alike
        return Target(frame, self.manipulator.planar, tolerance, turn, weight, self._guard)

    def _local(self, world: Target) -> Target:
        """Returns a target in the world in frame F_0."""
        return replace(world, frame=self._to_base @ world.frame)

    def _cost(self, configuration: Configuration, previous: Configuration) -> float:
        """Returns the weighted number of switches between two configurations."""
        own = self.manipulator.bits[np.arange(len(previous)), previous]
        new = self.manipulator.bits[np.arange(len(previous)), configuration]
        return float(((own != new) * self._weights).sum())

    def _fewest(
        self, world: Target, previous: Configuration, until: float, latest: float
    ) -> tuple[Configuration, float]:
        """Returns the cheapest configuration found, and the bound proven."""
        target = self._local(world)
        costs = criteria.switching(self.manipulator, previous, self._weights)
        worth = float(self._weights.sum() / len(self.manipulator.actuators))

        def first() -> Found:
            configuration = self._paths.follow(target, previous, "ipop-previous")
            tip = self.manipulator.tip(configuration)
            cost = self._cost(configuration, previous) if self._served(world, configuration) else np.inf
            return Found(configuration, cost, world.square(tip) if self._clear(configuration) else np.inf)

        def widen(best: Found, width: int) -> Found:
            return self._paths.spread(target, costs, worth, width, best)

        found = self._minimum.improve(target, previous, costs, first, widen, until, latest, self._hopeless(world))
        return found.configuration, min(found.bound, found.cost)

    @cached_property
    def _minimum(self) -> MinimumSwitch:
        return MinimumSwitch(self.manipulator, self._reach)
