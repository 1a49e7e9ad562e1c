"""Plans of whole trajectories, for `hyperbit plan`, the daemon's `plan` key and the library."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.plan import TrajectoryPlan
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.trajectory import MOST_POINTS, Trajectory, along
from hyperbit.controller.search.method import MINIMUM_SWITCH, Method
from hyperbit.controller.search.solution import SearchTime
from hyperbit.controller.search.solver import TIMEOUT, search_time

FIRST_TIME, WHOLE_TIME = 3.0, 4.0  # [s]: most for the first answers of all points; for the search of the whole

Array = NDArray[np.float64]


class TipGoals(NamedTuple):
    """TipGoals for the tip, in order."""

    positions: Array  # in the world, shape (n, dimension)
    tolerances: Array  # of the distances, shape (n,)
    rotations: Array  # in the world, shape (n, 3, 3); ignored where `turns` is infinite
    turns: Array  # tolerances of the orientations [rad], shape (n,); infinite where any orientation serves


def plan_whole(
    planner: TransitionPlanner,
    previous: Configuration,
    method: Method,
    first: SearchTime | None = None,
    seconds: float | None = None,
) -> TrajectoryPlan:
    """Returns the cheapest plan found for a trajectory: point by point first, then over the whole trajectory.

    Args:
        planner: of the trajectory's transitions.
        previous: configuration of the arm at the start, shape (B,).
        method: the search algorithm; the whole trajectory is searched for `minimum-switch` only.
        first: time for the first answers of all points; None: that of `first_time`.
        seconds: time for the search of the whole trajectory [s]; None: WHOLE_TIME.

    Raises:
        Refusal: see `PointByPoint.plan`.
    """
    allowed = search_time(first_time(planner.trajectory)) if first is None else first
    found = PointByPoint(planner, method, allowed).plan(previous)
    return found if method != MINIMUM_SWITCH else look_ahead(planner, found, previous, seconds)


def first_time(trajectory: Trajectory) -> float:
    """Returns the time [s] for the first answers of all points if no arm waits for them."""
    return min(TIMEOUT * len(trajectory.times), FIRST_TIME)


def look_ahead(
    planner: TransitionPlanner,
    found: TrajectoryPlan,
    previous: Configuration,
    seconds: float | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> TrajectoryPlan:
    """Returns a plan that costs at most as much as `found`, with the lower bound that is proven.

    Args:
        planner: of the trajectory's transitions.
        found: the plan to improve.
        previous: configuration before, shape (B,).
        seconds: time for the search [s], None: WHOLE_TIME; the time to stage its answer is extra.
        stop: returns whether to end sooner.
    """
    search = LabelSetting(planner.points, previous, stop)
    search.offer(
        np.array([solution.configuration for solution in found.solutions]), found.cost, found.solutions[0].bound
    )
    best = search.run(WHOLE_TIME if seconds is None else seconds)
    better = found
    if best.configurations is not None and best.cost < found.cost:
        better = found.improved(planner, 0, list(best.configurations), previous)
    return better.proven(best.bound) if better.cost <= found.cost else found.proven(best.bound)


def unhurried(goals: TipGoals, pace: Pace, path_tolerance: float | None = None) -> Trajectory:
    """Returns the trajectory through goals, with more time than the actuators need.

    Args:
        goals: if lines are followed, only positions and the least tolerance are used.
        pace: of the transitions.
        path_tolerance: greatest distance of the tip from the straight lines between goals; None: no lines are followed.

    Raises:
        Refusal: the lines are too long for the path tolerance.
    """
    times = pace.unhurried * MOST_POINTS * np.arange(len(goals.positions), dtype=np.float64)
    if path_tolerance is not None:
        return along(times, goals.positions, float(goals.tolerances.min()), path_tolerance, pace)
    points = np.arange(len(times))
    return Trajectory(None, times, goals.positions, goals.tolerances, goals.rotations, goals.turns, points)
