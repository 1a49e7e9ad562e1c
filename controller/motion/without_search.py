"""Solutions that need no search: a configuration that the goal names, and one that the arm holds."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.codes import GOAL_TOLERANCE_VIOLATED, Refusal
from controller.motion.sentences import place
from controller.motion.trajectory import Trajectory
from controller.search.solution import Solution
from controller.search.solver import Solver


def fixed(solver: Solver, trajectory: Trajectory, previous: Configuration, point: int) -> Solution:
    """Returns the solution of a point that is a configuration.

    Raises:
        Refusal: a locked actuator rules the configuration out, or the arm touches something in it.
    """
    goal, tolerance = trajectory.goal(point), float(trajectory.tolerances[point])
    try:
        configuration = solver.manipulator.configuration(trajectory.fixed[point])
    except ValueError as error:
        raise Refusal(GOAL_TOLERANCE_VIOLATED, f"{place(trajectory, point)}: a locked actuator: {error}") from None
    if solver.clearance is not None and (where := solver.clearance.where(configuration)) is not None:
        raise Refusal(GOAL_TOLERANCE_VIOLATED, f"{place(trajectory, point)}: {where}")
    return solver.described(configuration, goal, previous, tolerance, float(trajectory.turns[point]))


def held(solution: Solution, goal: NDArray[np.float64], tolerance: float) -> Solution | None:
    """Returns what holding a configuration is for the next point, None if it does not serve there."""
    error = float(np.linalg.norm(solution.tip[: len(goal), 3] - goal))
    if error > tolerance:
        return None
    return replace(solution, error=error, switches=0, seconds=0.0, cost=0.0, lower_bound=0.0)
