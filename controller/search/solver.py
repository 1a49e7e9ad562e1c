"""Inverse kinematics of one goal: the densities' descent, finished by the exact tail."""

import math
import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.manipulator.frames import Frame, inverse
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search import criteria
from controller.search.candidates import Candidates
from controller.search.descent import descend, spread
from controller.search.method import Method
from controller.search.minimum_switch import Found, MinimumSwitch
from controller.search.tail import build_tail, finish
from controller.workspace.densities import Densities

Vector = NDArray[np.float64]

# The primary criterion's threshold: as many configurations must be expected to end within the tolerance. The first asks
# little, to leave the secondary criterion room; the next is tried where the one before misses the tolerance; the last,
# which nothing reaches, makes the search POP.
ENOUGH = (30.0, 1_000.0, 10_000.0, np.inf)

DEADLINE = 0.05  # [s]
WIDTH = 32  # of the beam


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
        """Builds the exact table of the last modules.

        Args:
            manipulator: the arm.
            densities: of its intermediate workspaces.
            weights: of the actuators' switches, positive, shape (A,); all 1 if absent.
        """
        self.manipulator = manipulator
        self.densities = densities
        own = np.ones(len(manipulator.actuators)) if weights is None else np.asarray(weights, dtype=float)
        self._weights, self.least_weight = manipulator.per_module(own), float(own.min())
        self._tail = build_tail(manipulator)
        self._to_base = inverse(manipulator.base)
        self._candidates: tuple[int, Candidates] | None = None

    def prepare(self) -> None:
        """Claims the memory of the search for fewest switches, which the first searches would else wait for."""
        self._minimum.claim()

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
        local, world = self._local(goal)
        bound = 0.0
        if method in ("minimum-switch", "ipop-previous") and self._error(chosen, world) <= tolerance:
            best = chosen.copy()
        elif method == "minimum-switch":
            first = self._search(self._towards(local), chosen, tolerance, "ipop-previous")
            best, bound = self._fewest(local, world, chosen, tolerance, first, began + deadline)
        else:
            best = self._search(self._towards(local), chosen, tolerance, method)
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
        error = self._error(configuration, self._local(goal)[1])
        return Solution(
            configuration=configuration,
            tip=self.manipulator.tip(configuration),
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
        return self._candidates[1].find(self._local(goal)[0], previous, costs, tolerance)

    def _local(self, goal: ArrayLike) -> tuple[Vector, Vector]:
        """Returns a goal in frame F_0 and in the world, shape (3,) each."""
        world = np.zeros(3)
        world[: len(np.asarray(goal))] = goal
        return self._to_base[:3, :3] @ world + self._to_base[:3, 3], world

    def _error(self, configuration: Configuration, world: Vector) -> float:
        """Returns the distance of a configuration's tip from a point in the world."""
        return float(np.linalg.norm(self.manipulator.tip(configuration)[:3, 3] - world))

    def _cost(self, configuration: Configuration, previous: Configuration) -> float:
        """Returns the weighted number of switches between two configurations."""
        own = self.manipulator.bits[np.arange(len(previous)), previous]
        new = self.manipulator.bits[np.arange(len(previous)), configuration]
        return float(((own != new) * self._weights).sum())

    def _fewest(
        self, goal: Vector, world: Vector, previous: Configuration, tolerance: float, first: Configuration, until: float
    ) -> tuple[Configuration, float]:
        """Returns the cheapest configuration found from a first answer, and the bound proven."""
        error = self._error(first, world)
        cost = self._cost(first, previous) if error <= tolerance else np.inf
        costs = criteria.switching(self.manipulator, previous, self._weights)

        def widen(best: Found) -> Found:
            return self._spread(goal, costs, tolerance, best)

        found = self._minimum.improve(goal, previous, costs, tolerance, Found(first, cost, error**2), widen, until)
        return found.configuration, found.bound

    def _spread(self, goal: Vector, costs: criteria.Penalties, tolerance: float, best: Found) -> Found:
        """Returns the best of a beam's configurations for a goal in F_0, or `best` if none is cheaper."""
        m, d, t = self.manipulator, self.densities, self._tail
        configurations = np.zeros((WIDTH, len(m.modules)), dtype=np.int64)
        wanted, prices = np.zeros((WIDTH, 3)), np.zeros(WIDTH)
        worth = float(self._weights.sum() / len(m.actuators))
        count = spread(
            goal,
            m.rotations,
            m.translations,
            m.states,
            d.values,
            d.offsets,
            d.shapes,
            d.references,
            d.pixels,
            costs,
            worth,
            t.root,
            configurations,
            wanted,
            prices,
        )
        modules = np.arange(len(m.modules))
        for configuration, (x, y, z), price in zip(configurations[:count], wanted, prices, strict=False):
            if price < best.cost:
                error = self._finish(x, y, z, tolerance, costs, configuration)
                cost = float(costs[modules, configuration].sum())
                if error <= tolerance and cost < best.cost:
                    best = Found(configuration, cost, error**2)
        return best

    @cached_property
    def _minimum(self) -> MinimumSwitch:
        return MinimumSwitch(self.manipulator)

    def _towards(self, goal: Vector) -> Vector:
        """Returns `goal`, or, where it is outside the box of W_0, the centre of the nearest pixel that has points.

        Every density is as good as zero out there: distances to their boxes would lead the descent astray.
        """
        low, high = self.densities.box(0)
        if np.all((low <= goal) & (goal <= high)):
            return goal
        z, y, x = np.nonzero(self.densities.level(0) >= 0)
        centres = self.densities.references[0] + self.densities.pixels[0] * np.column_stack((x, y, z))
        return np.asarray(centres[np.argmin(np.linalg.norm(centres - goal, axis=1))])

    def _search(self, goal: Vector, previous: Configuration, tolerance: float, method: Method) -> Configuration:
        """Returns the first configuration within the tolerance as the threshold rises, else the nearest seen."""
        if method == "pop":
            return self._descend(goal, 0.0, criteria.indifferent(self.manipulator), np.inf)[0]
        if method == "ipop-previous":
            penalties = criteria.similarity(self.manipulator, previous)
        else:
            penalties = criteria.contraction(self.manipulator)
        best, best_error = previous, np.inf
        for enough in ENOUGH:
            configuration, error = self._descend(goal, tolerance, penalties, enough)
            if error < best_error:
                best, best_error = configuration, error
            if error <= tolerance:
                break
        return best

    def _descend(
        self, goal: Vector, tolerance: float, penalties: criteria.Penalties, enough: float
    ) -> tuple[Configuration, float]:
        """Returns configuration and error of one descent to `goal` (3,) in the base frame."""
        m, d, t = self.manipulator, self.densities, self._tail
        configuration = np.zeros(len(m.modules), dtype=np.int64)
        wanted = descend(
            goal,
            m.rotations,
            m.translations,
            m.states,
            d.values,
            d.offsets,
            d.shapes,
            d.references,
            d.pixels,
            penalties,
            self._thresholds(tolerance, enough),
            t.root,
            configuration,
        )
        return configuration, self._finish(*wanted, tolerance, penalties, configuration)

    def _finish(
        self,
        x: float,
        y: float,
        z: float,
        tolerance: float,
        penalties: criteria.Penalties,
        configuration: Configuration,
    ) -> float:
        """Fixes the modules that the densities leave, for a goal in frame F_root; returns the error."""
        m, t = self.manipulator, self._tail
        return finish(
            x,
            y,
            z,
            tolerance,
            t.root,
            t.depth,
            t.points,
            t.cell,
            t.corner,
            t.shape,
            t.starts,
            t.order,
            penalties,
            m.rotations,
            m.translations,
            m.states,
            configuration,
        )

    def _thresholds(self, tolerance: float, enough: float) -> NDArray[np.float64]:
        """Returns, for each level, the ln of a pixel's count at which `enough` points are within the tolerance."""
        if np.isinf(enough):
            return np.full(len(self.densities.pixels), np.inf)
        ball = math.pi * tolerance**2 if self.manipulator.planar else 4 / 3 * math.pi * tolerance**3
        volumes = self.densities.pixels**self.manipulator.dimension
        return np.log(np.maximum(enough * volumes / ball, 1.0))
