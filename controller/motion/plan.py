"""A trajectory's plan: the configuration for each waypoint, each searched from the one before."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.codes import GOAL_TOLERANCE_VIOLATED, Refusal
from controller.motion.goal import Trajectory
from controller.search.method import Method
from controller.search.solver import DEADLINE, Solution, Solver

PLANNING_TIME = 0.03  # [s] for the whole of a trajectory; what is left then is planned with the first answers


@dataclass(frozen=True, eq=False)
class Plan:
    """What will be done.

    Attributes:
        trajectory: the goal.
        solutions: one for each waypoint.
        actuator_states: of each waypoint's configuration, shape (n, A).
    """

    trajectory: Trajectory
    solutions: tuple[Solution, ...]
    actuator_states: NDArray[np.uint8]

    @property
    def switches(self) -> int:
        """Actuators that switch, all waypoints together."""
        return sum(solution.switches for solution in self.solutions)

    def improved(self, solver: Solver, first: int, configurations: Sequence[Configuration]) -> "Plan":
        """Returns the plan with other configurations from waypoint `first`, at least 1, on; the rest stays as it is."""
        solutions, states = list(self.solutions), self.actuator_states.copy()
        end = first + len(configurations)
        chosen = [*configurations, *(s.configuration for s in self.solutions[end : end + 1])]
        for k, configuration in enumerate(chosen, first):
            goal, before = self.trajectory.positions[k], solutions[k - 1].configuration
            solutions[k] = solver.described(configuration, goal, before, self.trajectory.tolerance)
            states[k] = solver.manipulator.actuator_states(configuration)
        return Plan(self.trajectory, tuple(solutions), states)


def plan(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    method: Method,
    proceed: Callable[[], None] = lambda: None,
) -> Plan:
    """Returns the plan of a trajectory.

    Args:
        solver: of the arm.
        trajectory: what is asked for.
        previous: configuration that the arm is in, shape (B,).
        method: the algorithm.
        proceed: called before each waypoint; a Refusal it raises ends the planning.

    Raises:
        Refusal: a waypoint is out of reach; the message has the nearest point found.
    """
    solutions: list[Solution] = []
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
        solutions.append(solution)
        previous = solution.configuration
    states = np.array([solver.manipulator.actuator_states(s.configuration) for s in solutions])
    return Plan(trajectory, tuple(solutions), states)
