"""Sentences on points of a trajectory, for refusals."""

import numpy as np

from controller.motion.trajectory import Trajectory
from controller.search.solution import Solution


def out_of_reach(trajectory: Trajectory, point: int, nearest: Solution) -> str:
    """Returns the sentence on a point that no configuration was found for."""
    goal, tolerance = trajectory.positions[point], trajectory.tolerances[point]
    bias = trajectory.bias
    wanted = ", ".join(f"{x:g}" for x in (goal if bias is None else goal + bias))
    tip = ", ".join(f"{x:.4f}" for x in nearest.tip[: len(goal), 3])
    if (turn := trajectory.turns[point]) < np.inf:
        away = f"{nearest.error:.4f} away and turned {nearest.angle:.4f} rad, tolerances {tolerance:g} and {turn:g}"
        found = f"is out of reach in this orientation; the nearest pose found is at ({tip}), {away}"
    else:
        away = f"{nearest.error:.4f} away, tolerance {tolerance:g}"
        found = f"is out of reach; the nearest point found is ({tip}), {away}"
    if bias is not None and bias.any():
        found += f"; the real tip is ({', '.join(f'{x:.4f}' for x in bias)}) beside the computed one"
    return f"{place(trajectory, point)}: ({wanted}) {found}"


def place(trajectory: Trajectory, point: int) -> str:
    """Returns what a point is called."""
    if trajectory.between(point):
        last = trajectory.last(point)
        return f"waypoints[{last}] to waypoints[{last + 1}]"
    return f"waypoints[{trajectory.last(point)}].{'configuration' if point in trajectory.fixed else 'position'}"
