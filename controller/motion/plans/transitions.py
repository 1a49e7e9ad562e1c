"""Transitions of a trajectory: the solution of each point, and the stages to it from the configuration before."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.plans.points import TrajectoryPoint, TrajectoryPoints
from hyperbit.controller.motion.stages.pacing import Blocked, Infeasible, Pace, Staged, Stager
from hyperbit.controller.motion.stages.program import restage
from hyperbit.controller.motion.trajectory import Trajectory, upwards
from hyperbit.controller.obstacles.distance import Index
from hyperbit.controller.obstacles.keep_out import KeepOutSet
from hyperbit.controller.obstacles.sweep import Sweep, sweep_of
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, leg, nth_waypoint
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver

AT_ONCE = Pace(0.0)


class PlannedTransition(NamedTuple):
    """The transition to one point."""

    solution: Solution  # of the point, with the switches and the cost of all stages
    staged: Staged


class TransitionPlanner:
    """Plans the transitions of one trajectory. The first may be late; the others must fit into their time.

    Attributes:
        solver: of the arm.
        trajectory: the goal.
        pace: of the transitions.
        points: of the trajectory, with their targets.
    """

    def __init__(self, solver: Solver, trajectory: Trajectory, pace: Pace = AT_ONCE) -> None:
        self.solver, self.trajectory, self.pace = solver, trajectory, pace
        self.points = TrajectoryPoints(solver, trajectory)
        self._stager = Stager(solver.manipulator, pace, sweep_for(solver))

    def solution_of(
        self, point: TrajectoryPoint, previous: Configuration, configuration: Configuration, bound: float = 0.0
    ) -> Solution:
        """Returns a configuration (B,) as the solution of a point, from the configuration `previous` (B,).

        `bound` is a proven lower bound of the cost of any configuration of the point. A point that is given as a
        configuration needs none: at least the actuators that differ must switch.
        """
        found = self.solver.described(configuration, point.target, previous)
        return replace(found, bound=min(bound, found.cost) if point.states is None else found.cost)

    def transition(
        self,
        point: TrajectoryPoint,
        previous: Configuration,
        solution: Solution,
        with_deviation: bool = True,
        detour: Index | None = None,
    ) -> PlannedTransition:
        """Returns the transition to a point from a configuration (B,), with the switches and the cost of its stages.

        A detour lists actuators (n,) that may switch one after the other, if no other order is clear. It switches more
        actuators than differ between the configurations. The bound of a solution holds for detours, too. Without an
        inrush bound, the deviation is computed only `with_deviation`.

        Raises:
            Refusal: the time from the point before is too short.
            Blocked: no collision-free stages were found.
        """
        available = self._available(point, solution)
        try:
            staged = self._stager.staged(previous, solution.configuration, available, with_deviation, detour)
        except Blocked:
            raise
        except Infeasible as error:
            raise self._too_fast(point, solution, f"{available:.3g}", str(error)) from None
        if len(staged.stages) == 1:  # no actuator switches twice
            return PlannedTransition(solution, staged)
        counts = staged.switches_from(self.solver.manipulator.actuator_states(previous))
        switches, cost = int(counts.sum()), self.solver.cost_of(counts)
        return PlannedTransition(replace(solution, switches=switches, cost=cost), staged)

    def _available(self, point: TrajectoryPoint, solution: Solution) -> float | None:
        """Returns the time of the transition to a point [s]; None: unlimited."""
        k, times, stamp = point.index, self.trajectory.times, self.trajectory.stamp
        if k > 0:
            return float(times[k] - times[k - 1])
        if stamp is None:
            return None
        return max(stamp + float(times[0]) - time.time(), self.pace.needed(solution.switches))

    def _too_fast(self, point: TrajectoryPoint, solution: Solution, available: str, needed: str) -> Refusal:
        """Returns the refusal of a point for which the time is too short; `available` is in seconds."""
        trajectory, number = self.trajectory, self.trajectory.next(point.index)
        if number == 0:
            return Refusal(Reason.TIME_TOO_SHORT, where=nth_waypoint(0), available=available, needed=needed)
        where = leg(number - 1)
        parts = int(trajectory.waypoints[number] - trajectory.waypoints[number - 1])
        if parts > 1:
            where += f", one of {parts} parts"
            needed += f", and the line {upwards(parts * self.pace.needed(solution.switches)):g} s"
        return Refusal(Reason.TIME_TOO_SHORT, where=where, available=available, needed=needed)


def first_transition(
    manipulator: Manipulator,
    pace: Pace,
    keep_out: KeepOutSet,
    commanded: NDArray[np.uint8],
    planned: Staged,
    proceed: Callable[[], object],
) -> Staged:
    """Returns the transition of the whole arm to the first point of a plan, from other actuator states than planned.

    Planned stages among obstacles stay if they are clear from there, because they may contain detours. The states
    `commanded` (A,) are those of a configuration. `proceed` is called before each check of a stage; it raises if the
    transition is no longer needed.

    Raises:
        Refusal: the stages would collide.
    """
    most = pace.inrush or len(commanded)
    if not keep_out.free:
        rows = np.vstack([commanded, planned.stages])
        fits = np.count_nonzero(rows[1:] != rows[:-1], axis=1).max() <= most
        if fits and keep_out.first_collision(commanded, planned.stages, proceed) is None:
            return planned
    stages = restage(manipulator, commanded, planned.stages, most)
    if (collision := keep_out.first_collision(commanded, stages, proceed)) is not None:
        raise Refusal(Reason.START_COLLIDES, collision=collision)
    return planned if np.array_equal(stages, planned.stages) else Staged(stages, None, planned.strict)


def sweep_for(solver: Solver) -> Sweep | None:
    """Returns the swept checks of transitions; None if there is nothing to collide with."""
    return None if solver.clearance is None or solver.clearance.free else sweep_of(solver.clearance)
