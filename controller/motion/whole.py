"""Plans of whole trajectories: the one planner of `hyperbit plan`, the daemon's `plan` and the library."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.label_setting import LabelSetting
from controller.motion.pacing import Pace
from controller.motion.plan import Plan, plan
from controller.motion.trajectory import MOST_POINTS, Trajectory, along
from controller.search.method import Method
from controller.search.solver import DEADLINE, Solver

FIRST_TIME, WHOLE_TIME = 3.0, 4.0  # [s] for the first answers of all points at most, and for the whole trajectory

Array = NDArray[np.float64]


class Goals(NamedTuple):
    """What the tip is to come to, one after the other.

    Attributes:
        positions: in the world, shape (n, dimension).
        tolerances: of the distances, shape (n,).
        rotations: in the world, shape (n, 3, 3), of no meaning where any will do.
        turns: tolerances of the orientations [rad], shape (n,); infinite where any will do.
    """

    positions: Array
    tolerances: Array
    rotations: Array
    turns: Array


def plan_whole(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    method: Method,
    pace: Pace,
    first: float | None = None,
    seconds: float | None = None,
) -> Plan:
    """Returns the plan of a trajectory: each point searched from the one before, or a better one if there is.

    Args:
        solver: of the arm.
        trajectory: what is asked for.
        previous: configuration that the arm is in, shape (B,).
        method: the algorithm; only for fewest switches is there a search over the whole trajectory.
        pace: of the transitions.
        first: time for the first answers of all points [s]; None: `first_time`.
        seconds: time for the search over the whole trajectory [s]; None: WHOLE_TIME.

    Raises:
        Refusal: see `plan`.
    """
    first = first_time(trajectory) if first is None else first
    found = plan(solver, trajectory, previous, method, pace=pace, seconds=first)
    return found if method != "minimum-switch" else look_ahead(solver, found, previous, pace, seconds)


def first_time(trajectory: Trajectory) -> float:
    """Returns the time [s] for the first answers of all points where nobody waits to move."""
    return min(DEADLINE * len(trajectory.times), FIRST_TIME)


def look_ahead(
    solver: Solver,
    found: Plan,
    previous: Configuration,
    pace: Pace,
    seconds: float | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Plan:
    """Returns a plan that costs no more than that found, and what is proven of it.

    Args:
        solver: of the arm.
        found: the plan to improve.
        previous: configuration before, shape (B,).
        pace: of the transitions.
        seconds: time for the search [s], None: WHOLE_TIME; staging its answer comes on top.
        stop: whether to end sooner.
    """
    search = LabelSetting(solver, found.trajectory, previous, stop)
    search.offer(
        np.array([solution.configuration for solution in found.solutions]), found.cost, found.solutions[0].bound
    )
    best = search.run(WHOLE_TIME if seconds is None else seconds)
    better = found
    if best.configurations is not None and best.cost < found.cost:
        better = found.improved(solver, pace, 0, list(best.configurations), previous)
    return better.proven(best.bound) if better.cost <= found.cost else found.proven(best.bound)


def unhurried(goals: Goals, pace: Pace, path_tolerance: float | None = None) -> Trajectory:
    """Returns the trajectory through goals with more time than the actuators need.

    Args:
        goals: positions only if lines are followed; the least of the tolerances holds for all then.
        pace: of the transitions.
        path_tolerance: of the tip's distance from the straight lines between the goals; None: any way.

    Raises:
        Refusal: the lines are too long for the path tolerance.
    """
    times = pace.unhurried * MOST_POINTS * np.arange(len(goals.positions), dtype=np.float64)
    if path_tolerance is not None:
        return along(times, goals.positions, float(goals.tolerances.min()), path_tolerance, pace)
    points = np.arange(len(times))
    return Trajectory(None, times, goals.positions, goals.tolerances, goals.rotations, goals.turns, points)
