"""The solver: finds configurations for goals, and paths through several goals."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, wraps
from queue import SimpleQueue
from threading import RLock
from typing import Any, TypeAlias

import numpy as np

from hyperbit.controller.library.arguments import Called, Configurations, Number, Numbers, typed
from hyperbit.controller.library.arm import Arm
from hyperbit.controller.library.errors import GoalError, PathError, ThreadError
from hyperbit.controller.library.goals import GoalLike, Goals, ToleratedGoal, all_with_tolerances, with_tolerances
from hyperbit.controller.library.obstacles import Obstacle, build_obstacles
from hyperbit.controller.library.path import Path
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.plans.whole import plan_whole, proof_means, tip_goals, unhurried
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.motion.trajectory import MOST_POINTS
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search import solver as search
from hyperbit.controller.search.method import METHODS, MINIMUM_SWITCH, Method
from hyperbit.controller.search.search_time import TIMEOUT, SearchTime, search_effort, search_time
from hyperbit.controller.search.solution import Solution

Start: TypeAlias = "Configurations | Solution | Path | None"


def by_one_thread(method: Called) -> Called:
    """Refuses a call while another thread is in a method of the same solver."""

    @wraps(method)
    def call(self: Solver, *args: Any, **kwargs: Any) -> Any:
        if not self._alone.acquire(blocking=False):
            raise ThreadError("another thread uses this solver: make a solver for each thread, or call solve_many")
        try:
            return method(self, *args, **kwargs)
        finally:
            self._alone.release()

    return call  # type: ignore[return-value]


@typed(GoalError)
class Solver:
    """Inverse kinematics of one arm. The tables are built at the first search.

    A solver serves one thread: use one for each thread.

    Args:
        arm: the arm; its own obstacles are respected as well.
        obstacles: further obstacles in the world; no module may touch them.
        weights: cost of a switch of each actuator, positive, shape (A,); None: the arm's weights.
        list_whole: whether all configurations are tried of an arm that has few, at most 16,384. Each answer is proven
            then. False: the searches for arms with more are used.

    Raises:
        ObstacleError: an obstacle is invalid, or has another dimension than the arm.
        GoalError: the weights are not A positive numbers.
        ThreadError: a method is called while another thread is in one.
    """

    def __init__(
        self,
        arm: Arm,
        *,
        obstacles: Sequence[Obstacle] = (),
        weights: Numbers | None = None,
        list_whole: bool = True,
    ) -> None:
        self.arm, self.list_whole = arm, list_whole
        self.obstacles = tuple(obstacles)
        self._regions = build_obstacles(obstacles, arm.dimension)
        self._weights = arm.weights if weights is None else np.array(weights, dtype=float)
        valid = np.isfinite(self._weights) & (self._weights > 0)
        if self._weights.shape != arm.weights.shape or not valid.all():
            raise GoalError(f"weights: {len(arm.actuators)} positive numbers are needed, one an actuator")
        self._others = list[search.Solver]()
        self._alone = RLock()

    def __repr__(self) -> str:
        """Returns the arm and the solver's own obstacles."""
        own = "".join(f", {obstacle!r}" for obstacle in self.obstacles)
        return f"Solver({self.arm!r}{own})"

    def _repr_html_(self) -> str:
        """Returns a picture of the arm among the obstacles for notebooks."""
        from hyperbit.controller.library.plot import html

        return html(repr(self), self.arm, self.obstacles)

    def __getstate__(self) -> dict[str, Any]:
        """Returns what is pickled: all but the tables, which the first search builds again."""
        return {name: value for name, value in vars(self).items() if name not in ("_search", "_alone")} | {
            "_others": []
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _alone=RLock())

    @by_one_thread
    def solve(
        self,
        goal: GoalLike,
        start: Start = None,
        *,
        method: Method = MINIMUM_SWITCH,
        deadline: Number | None = None,
        effort: Number | None = None,
        missed: Number | None = None,
    ) -> Solution:
        """Returns a configuration for a goal. If the goal is out of reach, returns the nearest configuration found.

        Args:
            goal: a goal, or a position of shape (dimension,).
            start: configuration (B,) as an array or text, or a solution or path whose end is the start; None: `home`.
            method: one of `METHODS`.
            deadline: longest time of the search [s]; a proof ends it sooner. None: 0.05 s, and 1 s for a goal that is
                not reached.
            effort: work for the search in place of `deadline`; one unit is about a millisecond of an ordinary computer.
                The solution is then the same on every run. A goal that is not reached by then gets `missed` in all, or
                the effort if it is more.
            missed: work for a goal that is not reached; None: 1000. Only with `effort`.

        Raises:
            GoalError: the goal has another dimension than the arm, or the method, deadline or effort is invalid.
            ConfigurationError: the start is no configuration of the arm.
        """
        allowed = checked_time(method, deadline, effort, missed)
        asked = with_tolerances(goal, self.arm.dimension, self.arm.tolerance, self.arm.angle_tolerance)
        return self._solve(self._search, asked, self._start(start), method, allowed)

    @by_one_thread
    def solve_many(
        self,
        goals: Goals,
        start: Start = None,
        *,
        method: Method = MINIMUM_SWITCH,
        deadline: Number | None = None,
        effort: Number | None = None,
        missed: Number | None = None,
    ) -> list[Solution]:
        """Returns a configuration for each goal, all from the same start, in the order of the goals.

        The goals are searched in threads, one for each processor core: the kernels run without Python's lock. Solutions
        are those of `solve`, if the searches end before their deadlines.

        Args:
            goals: goals, or positions of shape (dimension,).
            start: see solve.
            method: one of `METHODS`.
            deadline: see solve; of each goal.
            effort: see solve; of each goal.
            missed: see solve; of each goal.

        Raises:
            GoalError: see solve.
            ConfigurationError: the start is no configuration of the arm.
        """
        allowed = checked_time(method, deadline, effort, missed)
        asked, before = self._all_with_tolerances(goals), self._start(start)
        idle, count = SimpleQueue[search.Solver](), min(len(os.sched_getaffinity(0)), len(asked))
        for searcher in self._searches(count):
            idle.put(searcher)

        def solved(goal: ToleratedGoal) -> Solution:
            searcher = idle.get()
            try:
                return self._solve(searcher, goal, before, method, allowed)
            finally:
                idle.put(searcher)

        with ThreadPoolExecutor(max(count, 1)) as pool:
            return list(pool.map(solved, asked))

    @by_one_thread
    def follow(
        self,
        goals: Goals,
        start: Start = None,
        *,
        path_tolerance: Number | None = None,
        method: Method = MINIMUM_SWITCH,
        deadline: Number | None = None,
        prove: bool = False,
    ) -> Path:
        """Returns a path through goals.

        The goals are solved one after the other, as by `solve`. Then the method minimum-switch searches for fewest
        switches over the whole path, and for a proof. The daemon's `plan` and `hyperbit plan --goals` do the same.

        Args:
            goals: the goals, in their order.
            start: configuration (B,) as an array or text, or a solution or path whose end is the start; None: `home`.
            path_tolerance: greatest distance of the tip from the straight lines between the goals; None: no limit.
            method: one of `METHODS`.
            deadline: longest time of planning the path [s]; a proof ends it sooner, and the search for stages follows
                after it. None: up to 3 s for the first answers, and 4 s for the whole path, with `prove` 60 s.
            prove: whether the search over the whole path uses all processors, and up to 1.6 GB.

        Raises:
            GoalError: there is no goal, a goal has another dimension than the arm, or a deadline is not positive.
            ConfigurationError: the start is no configuration of the arm.
            PathError: a goal is out of reach, or an obstacle blocks the path.
        """
        longest = checked_deadline(method, deadline)
        if not 1 <= len(goals) <= MOST_POINTS:
            raise GoalError(f"1 to {MOST_POINTS} goals are needed, got {len(goals)}")
        asked = self._all_with_tolerances(goals)
        before, pace = self._start(start), pace_of(self.arm._arm.settings)
        line = None if path_tolerance is None else float(path_tolerance)
        if line is not None:
            if any(math.isfinite(one.angle_tolerance) for one in asked):
                raise GoalError("path_tolerance: lines are followed by position only, leave out orientations")
            if not 1e-9 <= line <= 1e6:
                raise GoalError(f"path_tolerance: a number from 1e-9 to 1e6 is needed, got {line!r}")
        try:
            goals = tip_goals(((one.target, one.tolerance, one.angle_tolerance) for one in asked), self.arm.dimension)
            trajectory = unhurried(goals, pace, line)
            planner = TransitionPlanner(self._search, trajectory, pace)
            found = plan_whole(planner, before, method, longest, proof=proof_means() if prove else None)
        except Refusal as refusal:
            raise PathError(str(refusal)) from None
        solutions = tuple(self._whole(solution) for solution in found.solutions)
        own = tuple(one.goal for one in asked)
        for array in (trajectory.positions, trajectory.waypoints):
            array.flags.writeable = False
        return Path(own, trajectory.positions, solutions, trajectory.waypoints, found.certificate, found.bound)

    @by_one_thread
    def contact(self, configuration: Configurations) -> str | None:
        """Returns the first collision of a configuration (B,), such as "module 7 is in disc 'pillar'", or None.

        Raises:
            ConfigurationError: the arm has no such configuration, or a locked actuator is in another state.
        """
        clearance = self._search.clearance
        return None if clearance is None else clearance.where(self.arm._to_reduced(configuration))

    @cached_property
    def _search(self) -> search.Solver:
        """The search, built at first use; its densities are computed or read from the cache."""
        arm, reduced = self.arm._arm, self.arm._reduced
        clearance, whole = arm.clearance(reduced, self._regions), self.list_whole
        solver = search.Solver(reduced, self.arm._densities, self._weights, clearance, list_whole=whole)
        solver.prepare()
        solver.rehearse()
        return solver

    def _searches(self, count: int) -> list[search.Solver]:
        """Returns searches that may run at the same time; they share tables."""
        while len(self._others) < count - 1:
            other = self._search.another()
            other.prepare()
            self._others.append(other)
        return [self._search, *self._others][:count]

    def _solve(
        self, searcher: search.Solver, asked: ToleratedGoal, before: Configuration, method: Method, allowed: SearchTime
    ) -> Solution:
        target = searcher.target(asked.target, asked.tolerance, asked.angle_tolerance)
        found = searcher.solve(target, before, method, timeout=allowed)
        return self._whole(searcher.explained(found, target, before, allowed))

    def _all_with_tolerances(self, goals: Goals) -> list[ToleratedGoal]:
        return all_with_tolerances(goals, self.arm.dimension, self.arm.tolerance, self.arm.angle_tolerance)

    def _start(self, start: Start) -> Configuration:
        """Returns the start configuration in the numbering of the reduced arm."""
        if isinstance(start, Path):
            start = start.solutions[-1]
        return self.arm._to_reduced(
            self.arm.home if start is None else start.configuration if isinstance(start, Solution) else start
        )

    def _whole(self, found: Solution) -> Solution:
        """Returns a solution with its configuration in the numbering of the whole arm."""
        found.tip.flags.writeable = False
        return replace(found, configuration=self.arm._to_whole(found.configuration))


def checked_time(
    method: str, deadline: Number | None, effort: Number | None, missed: Number | None = None
) -> SearchTime:
    """Returns the time of the search for one goal, or its work if an effort is given, see Solver.solve.

    Raises:
        GoalError: there is no such method, or a number is not positive.
    """
    longest = checked_deadline(method, deadline if effort is None else None)
    if effort is None:
        if missed is not None:
            raise GoalError("missed: give effort as well, a search by time has a deadline")
        return search_time(TIMEOUT if longest is None else longest, deadline=longest)
    for name, value in (("effort", effort), ("missed", missed)):
        if value is not None and not 0 < value < math.inf:
            raise GoalError(f"{name}: a positive number is needed, got {value!r}")
    return search_effort(float(effort), None if missed is None else float(missed))


def checked_deadline(method: str, deadline: Number | None) -> float | None:
    """Returns the deadline of a search [s].

    Raises:
        GoalError: there is no such method, or the deadline is not positive.
    """
    if method not in METHODS:
        raise GoalError(f"no method {method!r}; there are {', '.join(METHODS)}")
    if deadline is not None and not 0 < deadline < math.inf:
        raise GoalError(f"deadline: a positive number of seconds is needed, got {deadline!r}")
    return None if deadline is None else float(deadline)
