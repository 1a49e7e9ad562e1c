"""Inverse kinematics of one goal, by any method."""

import math
import time
from collections.abc import Iterator
from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.manipulator.frames import inverse
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.clearance import Clearance
from controller.obstacles.scene import scene_of
from controller.search.method import Method, switching
from controller.search.minimum_switch import MinimumSwitch, Problem
from controller.search.paths import Paths
from controller.search.solution import EPSILON, Incumbent, Solution
from controller.search.target import Target, distance
from controller.search.two_list import Candidates
from controller.workspace.densities import Densities
from controller.workspace.hull import build_hull

Vector = NDArray[np.float64]

DEADLINE = 0.05  # [s]
PATIENCE = 0.5  # [s] for an orientation that is not found sooner


class Solver:
    """Searches configurations of one manipulator; holds its tables, so that a goal costs microseconds.

    Attributes:
        manipulator: the arm.
        densities: of its intermediate workspaces.
        weights: of the actuators' switches, by module, shape (B, Amax).
        least_weight: of any actuator's switches.
        whole_weights: whether all weights are multiples of the least.
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
        self.clearance, self._scene = clearance, scene_of(manipulator, clearance)
        self.densities = densities
        own = np.ones(len(manipulator.actuators)) if weights is None else np.asarray(weights, dtype=float)
        self.weights, self.least_weight = manipulator.per_module(own), float(own.min())
        multiples = own / own.min()
        self.whole_weights = bool(np.all(np.abs(multiples - np.round(multiples)) < EPSILON / 10))
        self._paths = Paths(manipulator, densities)
        self._hull = build_hull(manipulator)
        self._to_base = inverse(manipulator.base)
        self._candidates: tuple[int, Candidates] | None = None

    def avoiding(self, clearance: Clearance | None) -> "Solver":
        """Returns a solver that keeps clear of something else, or of nothing.

        It shares the tables and the memory of this one: only one of them may search at a time.
        """
        other = copy(self)
        other.clearance, other._scene = clearance, scene_of(self.manipulator, clearance)
        return other

    def another(self) -> "Solver":
        """Returns a solver with the same tables and memory of its own: both may search at the same time."""
        other = copy(self)
        vars(other).pop("_minimum", None)
        other._candidates, other._scene = None, scene_of(self.manipulator, self.clearance)
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
        seed = np.asarray(previous, dtype=np.int64)
        costs = switching(self.manipulator, seed, self.weights)
        return self._minimum.expect(seed, costs, tolerance)

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
        seed = np.asarray(previous, dtype=np.int64)
        target = self.target(goal, tolerance, turn)
        incumbent = Incumbent(seed, began + deadline)
        if method in ("minimum-switch", "ipop-previous", "ipop-fewest-switches") and self._served(target, seed):
            incumbent.offer(seed.copy(), 0.0, 0.0)
        elif method == "minimum-switch":
            costs = switching(self.manipulator, seed, self.weights)
            patience = began + (max(deadline, patience) if target.hard else deadline)
            self._minimum.improve(Problem(target, seed, costs, patience, self._hopeless(target)), incumbent)
        else:
            best = self._paths.follow(target, seed, method)
            if target.hard and not self._served(target, best) and not self._hopeless(target):
                incumbent.until = began + patience  # densities know positions only
                incumbent.offer(best, np.inf, target.square(self.manipulator.tip(best)))
                self._minimum.reach(target, incumbent)
                best = incumbent.configuration
            incumbent = Incumbent(best, incumbent.until)
        return self._described(incumbent.configuration, target, seed, time.perf_counter() - began, incumbent.bound)

    def described(
        self,
        configuration: Configuration,
        goal: ArrayLike,
        previous: Configuration,
        tolerance: float,
        turn: float = math.inf,
    ) -> Solution:
        """Returns a configuration (B,) as the solution for a goal, whoever chose it."""
        return self._described(configuration, self.target(goal, tolerance, turn), previous)

    def candidates(
        self, goal: ArrayLike, previous: Configuration, tolerance: float, most: int, turn: float = math.inf
    ) -> tuple[NDArray[np.int64], Vector]:
        """Returns at most `most` of the cheapest configurations (n, B) within the tolerances, and their costs (n,).

        Only those that switch little are looked at; there may be none.
        """
        if self._candidates is None or self._candidates[0] != most:
            self._candidates = (most, Candidates(self.manipulator, most))
        costs = switching(self.manipulator, previous, self.weights)
        return self._candidates[1].find(self.target(goal, tolerance, turn), np.asarray(previous, dtype=np.int64), costs)

    def _described(
        self,
        configuration: Configuration,
        target: Target,
        previous: Configuration,
        seconds: float = 0.0,
        bound: float = 0.0,
    ) -> Solution:
        tip, clear = self.manipulator.tip(configuration), self._clear(configuration)
        cost = float(self.cost(configuration, previous))
        served = clear and target.met(configuration)
        return Solution(
            configuration=configuration,
            tip=tip,
            error=float(distance(tip, target.goal)),
            switches=self.manipulator.switches(configuration, previous),
            within_tolerance=served,
            seconds=seconds,
            cost=cost,
            bound=min(bound, cost) if served else bound,
            angle=target.angle(tip),
            clear=clear,
        )

    def _served(self, target: Target, configuration: Configuration) -> bool:
        """Returns whether a configuration is within the tolerances, and clear."""
        return target.met(configuration) and self._clear(configuration)

    def _hopeless(self, target: Target) -> bool:
        """Returns whether the goal lies so deep in obstacles that no clear tip can come within the tolerance."""
        return self.clearance is not None and self.clearance.buried(target.goal[:3, 3], target.tolerance)

    def _clear(self, configuration: Configuration) -> bool:
        return self.clearance is None or not self.clearance.blocked(configuration[None])[0]

    def target(self, goal: ArrayLike, tolerance: float, turn: float) -> Target:
        """Returns what a goal asks for; see solve.

        Raises:
            ValueError: the goal has a wrong number of coordinates, or the arm is planar and the goal is not.
        """
        given, frame = np.asarray(goal, dtype=float), np.eye(4)
        arm = "planar" if self.manipulator.planar else "spatial"
        if given.shape == (4, 4):
            frame = np.ascontiguousarray(given)
            if self.manipulator.planar and not np.allclose(frame[2], (0, 0, 1, 0), atol=1e-9):
                raise ValueError("the arm is planar, but the goal's frame is not in the plane z = 0")
        elif given.shape == (self.manipulator.dimension,):
            frame[: len(given), 3] = given
        else:
            size = self.manipulator.dimension
            raise ValueError(
                f"a goal of a {arm} arm is a position ({size},) or a frame (4, 4), got shape {given.shape}"
            )
        weight = tolerance / turn if turn < math.pi else 0.0  # so that both tolerances count alike
        local = self._to_base @ frame
        return Target(local, frame, self.manipulator, tolerance, turn, weight, self._scene)

    def cost(self, configurations: ArrayLike, previous: ArrayLike) -> Any:
        """Returns the weighted number of switches between configurations, both of shape (..., B), shape (...)."""
        bits, modules = self.manipulator.bits, np.arange(len(self.manipulator.modules))
        differ = bits[modules, np.asarray(previous)] != bits[modules, np.asarray(configurations)]
        return (differ * self.weights).sum(axis=(-2, -1))

    @cached_property
    def _minimum(self) -> MinimumSwitch:
        return MinimumSwitch(self.manipulator, self._hull, self._paths)
