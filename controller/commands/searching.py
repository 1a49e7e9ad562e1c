"""Goals of `plan`: each for itself, or followed along straight lines."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from controller.commands.common import Failed
from controller.config import Arm
from controller.manipulator import frames
from controller.manipulator.manipulator import Configuration
from controller.motion.codes import Refusal
from controller.search.method import Method

if TYPE_CHECKING:  # its kernels take a second to import: only those who search wait for it
    from controller.search.solution import Solution
    from controller.search.solver import Solver

Orientation = float | list[float] | None
Goals = list[tuple[list[float], Orientation, Configuration | None]]
Answer = tuple[list[float], Orientation, "Solution", bool]
Answers = Iterator[Answer]


def search(
    solver: Solver, wanted: Goals, start: Configuration, tolerance: float, turn: float, method: Method
) -> Answers:
    """Gives each goal with its solution, searched from the one before unless told; none is between goals."""
    for position, orientation, given in wanted:
        goal = np.array(position) if orientation is None else frame(position, orientation)
        own = start if given is None else given
        found = solver.solve(goal, own, tolerance, method, turn=np.inf if orientation is None else turn)
        start = found.configuration
        yield position, orientation, found, False


def given(solver: Solver, configuration: Configuration, start: Configuration, tolerance: float) -> Answer:
    """Returns a configuration as the solution for the position of its own tip; no search."""
    position = solver.manipulator.tip(configuration)[: solver.manipulator.dimension, 3]
    return position.tolist(), None, solver.described(configuration, position, start, tolerance), False


def frame(position: list[float], orientation: float | list[float]) -> frames.Frame:
    """Returns the tip's frame (4, 4) that a goal asks for."""
    if isinstance(orientation, float):
        return frames.planar(position[0], position[1], orientation)
    return frames.spatial(position, orientation)


def follow_lines(
    arm: Arm,
    solver: Solver,
    positions: list[list[float]],
    start: Configuration,
    tolerance: float,
    path_tolerance: float,
    method: Method,
) -> Answers:
    """Gives each point with its solution, and whether it is between goals, as a daemon with time enough plans them.

    Raises:
        Failed: the lines cannot be followed, why.
    """
    from controller.motion.pacing import Pace
    from controller.motion.plan import plan
    from controller.motion.trajectory import MOST_POINTS, along
    from controller.planning.improvement import Improvement

    pace = Pace(arm.travel_time, arm.settings.inrush, arm.settings.rest_time)
    times = pace.unhurried * MOST_POINTS * np.arange(len(positions), dtype=np.float64)
    try:
        trajectory = along(times, np.array(positions, dtype=np.float64), tolerance, path_tolerance, pace)
        found = plan(solver, trajectory, start, method, pace=pace)
    except Refusal as refusal:
        raise Failed(str(refusal)) from None
    if method == "minimum-switch":
        found = Improvement(solver, found, pace).whole()
    for k, solution in enumerate(found.solutions):
        yield trajectory.positions[k].tolist(), None, solution, trajectory.between(k)
