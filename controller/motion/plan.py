"""A trajectory's plan: the configuration for each waypoint, each searched from the one before, and the stages there."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.codes import GOAL_TOLERANCE_VIOLATED, INVALID_GOAL, Refusal
from controller.motion.goal import Trajectory
from controller.motion.pacing import Pace, Staged, Unfit
from controller.search.method import Method
from controller.search.solver import DEADLINE, Solution, Solver

PLANNING_TIME = 0.03  # [s] for the whole of a trajectory; what is left then is planned with the first answers


AT_ONCE = Pace(0.0)


@dataclass(frozen=True, eq=False)
class Plan:
    """What will be done.

    Attributes:
        trajectory: the goal.
        solutions: one for each waypoint.
        transitions: how each waypoint's configuration is switched to from the one before.
    """

    trajectory: Trajectory
    solutions: tuple[Solution, ...]
    transitions: tuple[Staged, ...]

    @property
    def actuator_states(self) -> NDArray[np.uint8]:
        """Of each waypoint's configuration, shape (n, A)."""
        return np.array([transition.stages[-1] for transition in self.transitions])

    @property
    def switches(self) -> int:
        """Actuators that switch, all waypoints together."""
        return sum(solution.switches for solution in self.solutions)

    def improved(self, solver: Solver, pace: Pace, first: int, configurations: Sequence[Configuration]) -> "Plan":
        """Returns the plan with other configurations from waypoint `first`, at least 1, on; the rest stays as it is.

        So does a part whose transitions would not fit in the time there is.
        """
        try:
            return self._changed(solver, pace, first, configurations)
        except Unfit:
            half = len(configurations) // 2
            if half == 0:
                return self
            beginning = self.improved(solver, pace, first, configurations[:half])
            return beginning.improved(solver, pace, first + half, configurations[half:])

    def _changed(self, solver: Solver, pace: Pace, first: int, configurations: Sequence[Configuration]) -> "Plan":
        solutions, transitions, times = list(self.solutions), list(self.transitions), self.trajectory.times
        end = first + len(configurations)
        chosen = [*configurations, *(s.configuration for s in self.solutions[end : end + 1])]
        for k, configuration in enumerate(chosen, first):
            goal, before = self.trajectory.positions[k], solutions[k - 1].configuration
            solutions[k] = solver.described(configuration, goal, before, self.trajectory.tolerance)
            available = float(times[k] - times[k - 1])
            transitions[k] = pace.staged(solver.manipulator, before, configuration, available)
        return Plan(self.trajectory, tuple(solutions), tuple(transitions))


def plan(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    method: Method,
    proceed: Callable[[], None] = lambda: None,
    pace: Pace = AT_ONCE,
) -> Plan:
    """Returns the plan of a trajectory.

    Args:
        solver: of the arm.
        trajectory: what is asked for.
        previous: configuration that the arm is in, shape (B,).
        method: the algorithm.
        proceed: called before each waypoint; a Refusal it raises ends the planning.
        pace: of the transitions.

    Raises:
        Refusal: a waypoint is out of reach, the message has the nearest point found; or the time to it is too short.
    """
    solutions, transitions = list[Solution](), list[Staged]()
    until = time.perf_counter() + PLANNING_TIME
    dimension = solver.manipulator.dimension
    for k, goal in enumerate(trajectory.positions):
        proceed()
        left = max(until - time.perf_counter(), 0.0)
        solution = solver.solve(goal, previous, trajectory.tolerance, method, min(DEADLINE, left))
        if not solution.within_tolerance:
            nearest = ", ".join(f"{x:.4f}" for x in solution.tip[:dimension, 3])
            wanted = ", ".join(f"{x:g}" for x in goal)
            raise Refusal(
                GOAL_TOLERANCE_VIOLATED,
                f"waypoints[{k}].position: ({wanted}) is out of reach; the nearest point found is ({nearest}),"
                f" {solution.error:.4f} away, tolerance {trajectory.tolerance:g}",
            )
        transitions.append(staged(solver, trajectory, previous, solution, k, pace))
        solutions.append(solution)
        previous = solution.configuration
    return Plan(trajectory, tuple(solutions), tuple(transitions))


def staged(
    solver: Solver, trajectory: Trajectory, previous: Configuration, solution: Solution, k: int, pace: Pace
) -> Staged:
    """Returns the transition to waypoint k; the first is late where there is too little time for it.

    Raises:
        Refusal: the time from waypoint k - 1 is too short.
    """
    if k > 0:
        available: float | None = float(trajectory.times[k] - trajectory.times[k - 1])
    elif trajectory.stamp is not None:
        left = trajectory.stamp + float(trajectory.times[0]) - time.time()
        available = max(left, pace.needed(solution.switches))
    else:
        available = None
    try:
        return pace.staged(solver.manipulator, previous, solution.configuration, available)
    except Unfit as error:
        where = f"waypoints[{k - 1}] to waypoints[{k}]" if k else "waypoints[0]"
        raise Refusal(INVALID_GOAL, f"{where}: {available:.3g} s, {error}") from None
