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
from controller.search.target import distance, within


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
    frame = np.eye(4)
    frame[: len(goal), 3] = goal
    if not within(solution.tip, frame, tolerance, np.inf):
        return None
    return replace(solution, error=distance(solution.tip, frame), switches=0, seconds=0.0, cost=0.0, bound=0.0)
