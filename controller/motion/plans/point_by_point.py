"""Plans of trajectories, point by point: each configuration is searched from the one before."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.plan import TrajectoryPlan
from hyperbit.controller.motion.plans.points import States, TrajectoryPoint
from hyperbit.controller.motion.plans.transitions import PlannedTransition, TransitionPlanner
from hyperbit.controller.motion.plans.ways_around import WaysAround, WayTime
from hyperbit.controller.motion.stages.pacing import Blocked
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.method import MINIMUM_SWITCH, Method
from hyperbit.controller.search.search_time import TIMEOUT, SearchTime, search_time
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.target import distance

# Time for all searches of a trajectory [s]. It is short because the arm waits. A part of it is reserved for one first
# answer a point, which is used when the rest of the time is over. Look-ahead computes the deviation of these later.
PLANNING_TIME, FIRST_ANSWER = 0.03, 0.0002
DEFAULT_TIME = search_time(PLANNING_TIME)

WAY_TIME = 0.25  # [s] at least, if the cheapest configuration is blocked


class PointByPoint:
    """Plans one trajectory point by point.

    `allowed` is the time of all searches together, except that `unfound` is that of each point. Only the first point's
    search is extended by its gap, because the others are improved later. `threads` search ways around obstacles.
    """

    def __init__(
        self, planner: TransitionPlanner, method: Method, allowed: SearchTime = DEFAULT_TIME, threads: int = 1
    ) -> None:
        count, seconds = len(planner.points), allowed.first
        self._planner, self._solver, self._method = planner, planner.solver, method
        self._allowed, self._threads = allowed, threads
        self._seconds = seconds - min(FIRST_ANSWER * count, 0.8 * seconds)
        self._longest = max(TIMEOUT, seconds / count)  # for one search
        self._began = 0.0
        self._proceed: Callable[[], bool] = lambda: False

    def plan(self, previous: Configuration, proceed: Callable[[], bool] = lambda: False) -> TrajectoryPlan:
        """Returns the plan of the trajectory from a configuration (B,).

        `proceed` is called before each point, and during the searches. It returns whether they must end soon; what it
        raises ends the planning.

        Raises:
            Refusal: a point is out of reach; the message gives the nearest one found. Or no collision-free transition
                was found, the time is too short, or the arm collides where it stands. Or a given configuration
                collides, or a locked actuator excludes it.
        """
        if self._solver.clearance is not None and (where := self._solver.clearance.where(previous)) is not None:
            raise Refusal(Reason.ARM_IN_OBSTACLE, collision=where)
        self._began, self._proceed = self._solver.clock.now(), proceed
        planned = list[PlannedTransition]()
        for point in self._planner.points:
            proceed()
            if point.between and (same := staying(planned[-1], point)) is not None:
                planned.append(same)
            elif (states := point.states) is not None:
                planned.append(self._to_given(point, states, previous))
            else:
                planned.append(self._to_found(point, previous))
            previous = planned[-1].solution.configuration
        solutions, transitions = zip(*planned, strict=True)
        return TrajectoryPlan(self._planner.trajectory, solutions, transitions, solutions[0].bound)

    def _to_given(self, point: TrajectoryPoint, states: States, previous: Configuration) -> PlannedTransition:
        """Returns the transition to a point that is given as a configuration."""
        try:
            configuration = self._solver.manipulator.configuration(states)
        except ValueError as error:
            raise Refusal(Reason.LOCKED_CONFIGURATION, where=point.place, error=str(error)) from None
        if self._solver.clearance is not None and (where := self._solver.clearance.where(configuration)) is not None:
            raise Refusal(Reason.GOAL_IN_OBSTACLE, where=point.place, collision=where)
        solution = self._planner.solution_of(point, previous, configuration)
        try:
            return self._planner.transition(point, previous, solution, self._with_deviation())
        except Blocked as blocked:
            return self._around(point, previous, solution, blocked)

    def _to_found(self, point: TrajectoryPoint, previous: Configuration) -> PlannedTransition:
        """Returns the transition to a configuration that is searched for a point."""
        remaining, with_deviation = self._remaining(), self._with_deviation()
        allowed = self._time(point, min(self._longest, remaining))
        solution = self._solver.solve(point.target, previous, self._method, allowed, self._proceed)
        if not solution.within_tolerance:
            raise out_of_reach(point, self._solver.explained(solution, point.target, previous))
        try:
            return self._planner.transition(point, previous, solution, with_deviation)
        except Blocked as blocked:
            return self._around(point, previous, solution, blocked)
        except Refusal:  # a search with more time may find fewer switches, which need less time
            allowed = self._time(point, TIMEOUT)
            solution = self._solver.solve(point.target, previous, self._method, allowed, self._proceed)
        try:
            return self._planner.transition(point, previous, solution)
        except Blocked as blocked:
            return self._around(point, previous, solution, blocked)

    def _around(
        self, point: TrajectoryPoint, previous: Configuration, cheapest: Solution, blocked: Blocked
    ) -> PlannedTransition:
        """Returns the transition to another configuration, or a detour, because that to the cheapest is blocked."""
        clock = self._solver.clock
        until = WayTime(self._began, clock.now() + WAY_TIME, self._allowed, self._proceed, clock)
        return WaysAround(self._planner, point, previous, cheapest, self._threads).find(blocked, until)

    def _time(self, point: TrajectoryPoint, first: float) -> SearchTime:
        """Returns the time of one search, whose first time is `first` [s]."""
        allowed = self._allowed
        left = max(self._began + allowed.most - self._solver.clock.now(), 0.0)
        return SearchTime(first, allowed.per_switch if point.index == 0 else 0.0, allowed.unfound, left)

    def _remaining(self) -> float:
        """Returns what is left of the first time of all searches [s]."""
        return max(self._began + self._seconds - self._solver.clock.now(), 0.0)

    def _with_deviation(self) -> bool:
        """Returns whether there is time to compute the deviation of a transition."""
        return self._method != MINIMUM_SWITCH or self._remaining() > 0


def staying(before: PlannedTransition, point: TrajectoryPoint) -> PlannedTransition | None:
    """Returns the point before as the next one, because the arm stays; None if the next is not within tolerance."""
    solution, staged = before
    if not point.target.met_by(solution.tip):
        return None
    error = distance(solution.tip, point.target.goal)
    solution = replace(solution, error=error, switches=0, seconds=0.0, cost=0.0, bound=0.0)
    return PlannedTransition(solution, replace(staged, stages=staged.stages[-1:], deviation_source=0.0))


def out_of_reach(point: TrajectoryPoint, nearest: Solution) -> Refusal:
    trajectory, k = point.trajectory, point.index
    goal, tolerance = trajectory.positions[k], trajectory.tolerances[k]
    bias = trajectory.bias
    wanted = ", ".join(f"{x:g}" for x in (goal if bias is None else goal + bias))
    tip = ", ".join(f"{x:.4f}" for x in nearest.tip[: len(goal), 3])
    if (turn := trajectory.turns[k]) < np.inf:
        away = f"{nearest.error:.4f} away and turned {nearest.angle:.4f} rad, tolerances {tolerance:g} and {turn:g}"
        turned, found = " in this orientation", f"the nearest pose found is at ({tip}), {away}"
    else:
        away = f"{nearest.error:.4f} away, tolerance {tolerance:g}"
        turned, found = "", f"the nearest point found is ({tip}), {away}"
    if bias is not None and bias.any():
        found += f"; the tip bias is ({', '.join(f'{x:.4f}' for x in bias)})"
    if nearest.obstacle is not None:
        return Refusal(Reason.GOAL_IN_OBSTACLE, where=point.place, collision=f"({wanted}) {nearest.reach}")
    if nearest.collision is not None:
        return Refusal(
            Reason.ONLY_BY_COLLISION,
            where=point.place,
            position=wanted,
            reach=nearest.reach,
            turned=turned,
            nearest=found,
        )
    if nearest.certificate == "unreachable":
        return Refusal(Reason.OUT_OF_REACH, where=point.place, position=wanted, turned=turned, nearest=found)
    return Refusal(Reason.NOT_FOUND, where=point.place, position=wanted, turned=turned, nearest=found)
