"""Inverse kinematics of one goal by any method: the entry of the search."""

import math
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.manipulator.frames import inverse
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.scene import scene_of
from hyperbit.controller.search.clock import EFFORT, START, WALL, Clock
from hyperbit.controller.search.descent.paths import Paths
from hyperbit.controller.search.enumeration import Enumeration
from hyperbit.controller.search.lists.two_list import ListSizes, TwoList
from hyperbit.controller.search.method import MINIMUM_SWITCH, Method, cost_of_switches, switch_costs
from hyperbit.controller.search.minimum_switch import MinimumSwitch
from hyperbit.controller.search.neighbours.chain import Chain, chain_of
from hyperbit.controller.search.search_time import LISTED_WHOLE, TIMEOUT, SearchTime, search_time
from hyperbit.controller.search.solution import EPSILON, Incumbent, Solution
from hyperbit.controller.search.target import Problem, SearchTarget, distance
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.hull import build_hull

Vector = NDArray[np.float64]

REHEARSAL = 50.0  # effort of a search that loads kernels
CANDIDATE_ROWS = 1 << 12  # rows of each half among which candidates are matched


class Solver:
    """Finds configurations of one manipulator; holds its tables and the memory of its searches.

    Attributes:
        manipulator: the arm.
        densities: densities of its intermediate workspaces.
        weights: cost of a switch of each actuator, by module, shape (B, Amax).
        least_weight, mean_weight: the least of them, and their mean.
        whole_weights: whether all weights are multiples of the least.
        clearance: obstacles of this arm; None if it has nothing to avoid.
        clock: of searches and plans, unless they are limited by work.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        densities: Densities,
        weights: ArrayLike | None = None,
        clearance: BodyClearance | None = None,
        *,
        list_whole: bool = True,
        list_sizes: ListSizes = ListSizes(),
    ) -> None:
        """Builds the tables.

        `weights` (A,) are the positive costs of a switch of each actuator; None: all 1. Answers are clear of the
        obstacles of `clearance` even if the previous configuration is not. With `list_whole`, all configurations of an
        arm with few are tried. `list_sizes` are those of minimum-switch searches.
        """
        self.manipulator, self._list_whole, self._list_sizes = manipulator, list_whole, list_sizes
        self.clock: Clock = WALL
        self.clearance, self.scene = clearance, scene_of(manipulator, clearance)
        self.densities = densities
        own = np.ones(len(manipulator.actuators)) if weights is None else np.asarray(weights, dtype=float)
        self.weights, self.least_weight = manipulator.per_module(own), float(own.min())
        self.mean_weight = float(own.mean())
        multiples = own / own.min()
        self.whole_weights = bool(np.all(np.abs(multiples - np.round(multiples)) < EPSILON / 10))
        self.paths = Paths(manipulator, densities)
        self._hull = build_hull(manipulator)
        self._to_base = inverse(manipulator.base)

    def avoiding(self, clearance: BodyClearance | None) -> "Solver":
        """Returns a solver with other obstacles.

        It shares tables and memory with this solver, so only one of the two may search at a time.
        """
        other = copy(self)
        other.clearance, other.scene = clearance, scene_of(self.manipulator, clearance)
        return other

    def another(self) -> "Solver":
        """Returns a solver with the same tables but its own memory. Both may search at the same time."""
        other = copy(self)
        for memory in ("minimum", "_candidate_lists"):
            vars(other).pop(memory, None)
        other.scene = scene_of(self.manipulator, self.clearance)
        return other

    def prepare(self) -> None:
        """Allocates the memory of minimum-switch searches, so that the first searches do not wait for it."""
        if self.enumeration is None:
            self.minimum.claim()

    def rehearse(self) -> None:
        """Searches two goals without use, so that the first searches do not wait for machine code of kernels."""
        far = self.manipulator.states - 1
        near = far.copy()
        near[-1] = 0
        for seed in (np.zeros_like(far), near):
            position = self.manipulator.tip(far)[: self.manipulator.dimension, 3]
            target = self.target(position, 1e-3 * self.manipulator.length)
            self.solve(target, seed, timeout=SearchTime(REHEARSAL * EFFORT, by_work=True))

    def expect(self, previous: ArrayLike, tolerance: float) -> Iterator[None]:
        """Prepares a minimum-switch search from a configuration (B,), step by step, before its goal is known.

        `tolerance` is the one that is expected.
        """
        seed = np.asarray(previous, dtype=np.int64)
        costs = switch_costs(self.manipulator, seed, self.weights)
        return self.minimum.expect(seed, costs, tolerance) if self.enumeration is None else iter(())

    def target(self, goal: ArrayLike, tolerance: float, angle_tolerance: float = math.inf) -> SearchTarget:
        """Returns a goal as the target of searches by this solver, among its present obstacles.

        Args:
            goal: position of the tip in the world, shape (2,) or (3,), or its frame, shape (4, 4).
            tolerance: greatest distance of the tip from the goal.
            angle_tolerance: greatest angle between the orientations [rad]; infinite without orientation.

        Raises:
            ValueError: the goal has the wrong number of coordinates, or leaves the plane of a planar arm.
        """
        given, frame, size = np.asarray(goal, dtype=float), np.eye(4), self.manipulator.dimension
        if given.shape == (4, 4):
            frame = np.ascontiguousarray(given)
            if self.manipulator.planar and not np.allclose(frame[2], (0, 0, 1, 0), atol=1e-9):
                raise ValueError("the arm is planar, but the goal's frame is not in the plane z = 0")
        elif given.shape == (size,):
            frame[:size, 3] = given
        else:
            arm = "planar" if self.manipulator.planar else "spatial"
            raise ValueError(
                f"a goal of a {arm} arm is a position ({size},) or a frame (4, 4), got shape {given.shape}"
            )
        weight = tolerance / angle_tolerance if angle_tolerance < math.pi else 0.0  # both tolerances count alike
        local = self._to_base @ frame
        return SearchTarget(local, frame, self.manipulator, tolerance, angle_tolerance, weight, self.scene)

    def solve(
        self,
        target: SearchTarget,
        previous: ArrayLike,
        method: Method = MINIMUM_SWITCH,
        timeout: SearchTime | float = TIMEOUT,
        hurried: Callable[[], bool] = lambda: False,
    ) -> Solution:
        """Returns the solution of a target.

        Args:
            target: goal and tolerances, from `target` of this solver.
            previous: configuration before, from which switches are counted, shape (B,).
            method: `minimum-switch`, or POP or IPOP (section 3.2) with its secondary criterion.
            timeout: time or work of a minimum-switch search. A number is its first time [s], see `search_time`.
            hurried: see Incumbent.
        """
        started, weight = self.clock.now(), self.mean_weight
        seed = np.asarray(previous, dtype=np.int64)
        allowed = timeout if isinstance(timeout, SearchTime) else search_time(timeout)
        clock = allowed.clock(self.clock)
        began = clock.now()
        clock.charge(START)

        def later(gap: float) -> float:
            return began + allowed.allowed(gap / weight)

        incumbent = Incumbent(seed, began + allowed.allowed(0.0), later, hurried, clock)
        if method in (MINIMUM_SWITCH, "ipop-previous", "ipop-fewest-switches") and self.feasible(target, seed):
            incumbent.offer(seed.copy(), 0.0, 0.0)
        elif method == MINIMUM_SWITCH:
            costs = switch_costs(self.manipulator, seed, self.weights)
            search = self.minimum if self.enumeration is None else self.enumeration
            search.improve(Problem(target, seed, costs, self._unreachable(target)), incumbent)
        else:
            best = self.paths.follow(target, seed, method, clock)
            if target.hard and not self.feasible(target, best) and not self._unreachable(target):
                incumbent.offer(best, np.inf, target.square(self.manipulator.tip(best)))
                incumbent.extend()  # densities have no orientations
                self.minimum.repair(target, incumbent)
                best = incumbent.configuration
            incumbent = Incumbent(best, incumbent.until)
        seconds = self.clock.now() - started
        effort = round((clock.now() - began) / EFFORT, 3) if allowed.by_work else None
        found = self.described(incumbent.configuration, target, seed)
        bound = min(incumbent.bound, found.cost) if found.within_tolerance else incumbent.bound
        obstacle = None
        if not found.within_tolerance and self.clearance is not None:
            obstacle = self.clearance.holding(target.goal[:3, 3])
        return replace(found, seconds=seconds, bound=bound, effort=effort, obstacle=obstacle)

    def explained(
        self, missed: Solution, target: SearchTarget, previous: ArrayLike, allowed: SearchTime | None = None
    ) -> Solution:
        """Returns a solution of `solve` with the collision that keeps it from a missed goal, if one is found.

        A configuration that reaches the goal without obstacles is searched, for TIMEOUT or as `allowed`.
        """
        if missed.within_tolerance or missed.obstacle or self.clearance is None or self.clearance.free:
            return missed
        timeout = SearchTime(TIMEOUT) if allowed is None else allowed._replace(unfound=allowed.first)
        free = self.avoiding(None)
        found = free.solve(replace(target, scene=None), previous, MINIMUM_SWITCH, timeout)
        collision = self.clearance.where(found.configuration) if found.within_tolerance else None
        return replace(missed, collision=collision)

    def candidates(
        self, target: SearchTarget, previous: Configuration, most: int
    ) -> tuple[NDArray[np.int64], Vector, bool]:
        """Returns at most `most` of the cheapest configurations (n, B) within the tolerances, and their costs (n,).

        The search is limited to configurations near `previous`; it may find none. The last value is whether there are
        no others.
        """
        seed, costs = np.asarray(previous, dtype=np.int64), switch_costs(self.manipulator, previous, self.weights)
        self._candidate_lists.list(seed, costs, costs)
        return self._candidate_lists.cheapest(target, most)

    def described(self, configuration: Configuration, target: SearchTarget, previous: Configuration) -> Solution:
        """Returns a given configuration (B,) as the solution of a target, without a bound; see solve."""
        tip, clear = self.manipulator.tip(configuration), self._clear(configuration)
        differ = self._differ(configuration, previous)
        return Solution(
            configuration=configuration,
            tip=tip,
            error=float(distance(tip, target.goal)),
            switches=int(np.count_nonzero(differ)),
            within_tolerance=clear and target.met_by(tip),
            seconds=0.0,
            cost=float(cost_of_switches(differ, self.weights)),
            angle=target.angle(tip),
            clear=clear,
            dimension=self.manipulator.dimension,
        )

    def feasible(self, target: SearchTarget, configuration: Configuration) -> bool:
        """Returns whether a configuration (B,) is within the tolerances and clear."""
        return target.met(configuration) and self._clear(configuration)

    def _unreachable(self, target: SearchTarget) -> bool:
        """Returns whether the goal is so deep inside an obstacle that no clear tip is within the tolerance."""
        return self.clearance is not None and self.clearance.buried(target.goal[:3, 3], target.tolerance)

    def _clear(self, configuration: Configuration) -> bool:
        return self.clearance is None or not self.clearance.blocked(configuration[None])[0]

    def cost(self, configurations: ArrayLike, previous: ArrayLike) -> Any:
        """Returns the cost of the switches (...) between configurations, both (..., B)."""
        return cost_of_switches(self._differ(configurations, previous), self.weights)

    def _differ(self, configurations: ArrayLike, previous: ArrayLike) -> NDArray[np.bool_]:
        """Returns which actuators (..., B, Amax) differ between configurations, both (..., B)."""
        bits, modules = self.manipulator.bits, np.arange(len(self.manipulator.modules))
        return np.asarray(bits[modules, np.asarray(previous)] != bits[modules, np.asarray(configurations)])

    def cost_of(self, counts: ArrayLike) -> float:
        """Returns the cost of switches, from how often each actuator switches, shape (A,)."""
        return float(cost_of_switches(self.manipulator.per_module(counts), self.weights))

    @cached_property
    def _candidate_lists(self) -> TwoList:
        return TwoList(self.manipulator, CANDIDATE_ROWS)

    @cached_property
    def chain(self) -> Chain:
        """The arm for kernels."""
        return chain_of(self.manipulator, self.weights, self.least_weight, self.whole_weights)

    @cached_property
    def enumeration(self) -> Enumeration | None:
        """All configurations, if they are few; None if they are not to be listed."""
        few = np.prod(self.manipulator.states.astype(float)) <= LISTED_WHOLE
        return Enumeration(self.manipulator) if self._list_whole and few else None

    @cached_property
    def minimum(self) -> MinimumSwitch:
        return MinimumSwitch(self.manipulator, self._hull, self.paths, self.chain, self._list_sizes)
