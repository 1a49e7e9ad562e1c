"""Plans of whole trajectories, for `hyperbit plan`, the daemon's `plan` key and the library."""

import os
from collections.abc import Callable, Iterable
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
from hyperbit.controller.search.search_time import TIMEOUT, search_time

FIRST_TIME, WHOLE_TIME = 3.0, 4.0  # [s]: most for the first answers of all points; for the search of the whole
PROOF_TIME = 60.0  # [s] for the search of the whole if a proof is asked for

Array = NDArray[np.float64]


class Means(NamedTuple):
    """What the search over a whole trajectory may use."""

    threads: int = 1
    labels: int = 1 << 22  # see LabelSetting; with this number a thread takes about 150 MB


def proof_means(processes: int = 1) -> Means:
    """Returns the means of a proof: all processors, or the share of one of some processes, and up to 1.6 GB."""
    return Means(max(len(os.sched_getaffinity(0)) // processes, 1), 1 << 25)


class TipGoals(NamedTuple):
    """Goals for the tip, in order."""

    positions: Array  # in the world, shape (n, dimension)
    tolerances: Array  # of the distances, shape (n,)
    rotations: Array  # in the world, shape (n, 3, 3); ignored where `turns` is infinite
    turns: Array  # tolerances of the orientations [rad], shape (n,); infinite where any orientation serves


def tip_goals(goals: Iterable[tuple[Array, float, float]], dimension: int) -> TipGoals:
    """Returns goals as arrays.

    Each has a position (dimension,) or a frame (4, 4), the tolerance of the position, and that of the orientation
    [rad], infinite without one.
    """
    targets, tolerances, turns = zip(*goals, strict=True)
    framed = [target.ndim == 2 for target in targets]
    positions = [it[:dimension, 3] if full else it for it, full in zip(targets, framed, strict=True)]
    rotations = [it[:3, :3] if full else np.eye(3) for it, full in zip(targets, framed, strict=True)]
    return TipGoals(np.array(positions), np.array(tolerances), np.array(rotations), np.array(turns))


def plan_whole(
    planner: TransitionPlanner,
    previous: Configuration,
    method: Method,
    deadline: float | None = None,
    per_switch: float = 0.0,
    proof: Means | None = None,
) -> TrajectoryPlan:
    """Returns the cheapest plan found from a configuration (B,): point by point first, then over the whole trajectory.

    The whole trajectory is searched for `minimum-switch` only.

    Args:
        planner: of the trajectory.
        previous: the configuration.
        method: search method.
        deadline: longest time of planning [s]. None: that of the first answers, and WHOLE_TIME for the whole.
        per_switch: see SearchTime; for the first answers.
        proof: means of a search that goes on until its proof; then None of `deadline` is PROOF_TIME for the whole.

    Raises:
        Refusal: see `PointByPoint.plan`.
    """
    clock = planner.solver.clock
    began, allowed = clock.now(), search_time(first_time(planner.trajectory), per_switch, deadline)
    found = PointByPoint(planner, method, allowed).plan(previous)
    if method != MINIMUM_SWITCH:
        return found
    left = began + deadline - clock.now() if deadline is not None else WHOLE_TIME if proof is None else PROOF_TIME
    return look_ahead(planner, found, previous, left, means=proof or Means())


def first_time(trajectory: Trajectory) -> float:
    """Returns the time [s] for the first answers of all points if no arm waits for them."""
    return min(TIMEOUT * len(trajectory.times), FIRST_TIME)


def look_ahead(
    planner: TransitionPlanner,
    found: TrajectoryPlan,
    previous: Configuration,
    seconds: float,
    stop: Callable[[], bool] = lambda: False,
    means: Means = Means(),
) -> TrajectoryPlan:
    """Returns a plan from a configuration (B,) that costs at most as much as `found`, with the proven lower bound.

    The search takes `seconds`, or ends if `stop` returns true. Staging its answer takes extra time.
    """
    search = LabelSetting(planner.solver, list(planner.points), previous, stop, *means)
    search.offer(
        np.array([solution.configuration for solution in found.solutions]), found.cost, found.solutions[0].bound
    )
    best = search.run(seconds)
    better = found
    if best.configurations is not None and best.cost < found.cost:
        better = found.improved(planner, 0, list(best.configurations), previous)
    return better.proven(best.bound) if better.cost <= found.cost else found.proven(best.bound)


def unhurried(goals: TipGoals, pace: Pace, path_tolerance: float | None = None) -> Trajectory:
    """Returns the trajectory through goals, with more time than the actuators need.

    The tip stays within the path tolerance of the straight lines between goals; None: no lines are followed. If lines
    are followed, only positions and the least tolerance are used.

    Raises:
        Refusal: the lines are too long for the path tolerance.
    """
    times = pace.unhurried * MOST_POINTS * np.arange(len(goals.positions), dtype=np.float64)
    if path_tolerance is not None:
        return along(times, goals.positions, float(goals.tolerances.min()), path_tolerance, pace)
    points = np.arange(len(times))
    return Trajectory(None, times, goals.positions, goals.tolerances, goals.rotations, goals.turns, points)
