"""Searches for the goals of `plan`: for each goal separately, or for all goals as one trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from controller.arm.arm import Arm
from controller.commands.common import CommandFailed, densities_of, errors
from controller.commands.goal_rows import Orientation
from controller.commands.study.plan_goals import PlanOptions, PlanTask, WantedGoal
from controller.manipulator.manipulator import Configuration
from controller.refusals.refusal import Refusal
from controller.search.method import Method

if TYPE_CHECKING:  # the search's kernels take a second to import
    from controller.motion.plans.plan import TrajectoryPlan
    from controller.motion.plans.whole import TipGoals
    from controller.motion.trajectory import Trajectory
    from controller.search.solution import Solution
    from controller.search.solver import Solver


class PointSolution(NamedTuple):
    """The solution of a goal, or of a point between two goals.

    Attributes:
        position: of the goal, shape (dimension,).
        orientation: of the goal, an angle [rad] or a quaternion; None: any orientation.
        solution: configuration, tip and certificate.
        between: whether the point lies on a line between goals.
        whole: switches, cost and certificate of the whole trajectory, for JSON; None: a separate search.
    """

    position: list[float]
    orientation: Orientation
    solution: Solution
    between: bool = False
    whole: dict[str, Any] | None = None


class GoalSearch(NamedTuple):
    """A prepared solver, and how to search with it.

    Attributes:
        arm: the arm.
        solver: of the reduced arm.
        tolerance: position tolerance.
        angle_tolerance: orientation tolerance [rad] of goals with an orientation.
        path_tolerance: follow straight lines between the goals within this distance; None: do not.
        method: search method.
        deadline: longest time of planning [s]; None: no bound of its own.
    """

    arm: Arm
    solver: Solver
    tolerance: float
    angle_tolerance: float
    path_tolerance: float | None
    method: Method
    deadline: float | None = None


def prepared_search(arm: Arm, options: PlanOptions, *, silent: bool) -> GoalSearch:
    """Returns a search with the options, the arm's values as defaults; `silent` hides the progress bar."""
    from controller.search.solver import Solver

    solver = Solver(arm.reduced, densities_of(arm, silent=silent), arm.weights(), arm.clearance(arm.reduced))
    solver.prepare()
    return GoalSearch(
        arm,
        solver,
        options.tolerance or arm.tolerance,
        options.angle_tolerance or arm.angle_tolerance,
        options.path_tolerance,
        options.method or arm.settings.method,
        options.deadline,
    )


def described(search: GoalSearch, task: PlanTask, configuration: Configuration) -> PointSolution:
    """Returns a configuration as the solution of its own tip position, without a search."""
    position = search.solver.manipulator.tip(configuration)[: search.solver.manipulator.dimension, 3]
    target = search.solver.target(position, search.tolerance)
    solution = search.solver.described(configuration, target, task.start)
    return PointSolution(position.tolist(), None, solution)


def search_each(search: GoalSearch, goals: list[WantedGoal], start: Configuration) -> Iterator[PointSolution]:
    """Yields the solution of each goal, searched separately.

    Each search starts at the previous solution, or at the goal's own previous configuration.
    """
    from controller.search.solver import TIMEOUT, search_time

    solver, per_switch = search.solver, search.arm.settings.planning.seconds_per_switch
    allowed = search_time(TIMEOUT, per_switch, search.deadline)
    for goal in goals:
        own = start if goal.previous is None else goal.previous
        angle_tolerance = np.inf if goal.orientation is None else search.angle_tolerance
        target = solver.target(goal.target(), search.tolerance, angle_tolerance)
        found = solver.solve(target, own, search.method, allowed)
        start = found.configuration
        yield PointSolution(goal.position, goal.orientation, found)


def follow(search: GoalSearch, goals: list[WantedGoal], start: Configuration) -> Iterator[PointSolution]:
    """Yields the solution of each point of a trajectory, as the daemon answers `plan`.

    The trajectory leaves enough time for all switches. A goal with a previous configuration begins a new trajectory.
    Goals that cannot be planned as one trajectory are searched separately.

    Args:
        search: the search.
        goals: the goals.
        start: configuration before the first goal, shape (B,).

    Raises:
        CommandFailed: the lines between the goals cannot be followed.
    """
    from controller.motion.plans.transitions import TransitionPlanner
    from controller.motion.plans.whole import first_time, plan_whole, unhurried
    from controller.motion.stages.pacing import pace_of
    from controller.search.solver import search_time

    pace, per_switch = pace_of(search.arm.settings), search.arm.settings.planning.seconds_per_switch
    for part in trajectories(goals):
        start = start if part[0].previous is None else part[0].previous
        try:
            trajectory = unhurried(as_arrays(search, part), pace, search.path_tolerance)
            planner = TransitionPlanner(search.solver, trajectory, pace)
            first = search_time(first_time(trajectory), per_switch, search.deadline)
            found = plan_whole(planner, start, search.method, first, search.deadline)
        except Refusal as refusal:
            if search.path_tolerance is not None:
                raise CommandFailed(str(refusal)) from None
            errors.print(f"no plan of the whole trajectory: {refusal}; each goal is searched separately")
            for answer in search_each(search, [goal._replace(previous=None) for goal in part], start):
                start = answer.solution.configuration
                yield answer
        else:
            yield from points(part, trajectory, found)
            start = found.solutions[-1].configuration


def trajectories(goals: list[WantedGoal]) -> list[list[WantedGoal]]:
    """Returns the goals of each trajectory; a goal with a previous configuration begins a new one."""
    begins = [k for k, goal in enumerate(goals) if k == 0 or goal.previous is not None]
    return [goals[first:end] for first, end in zip(begins, [*begins[1:], len(goals)], strict=True)]


def points(goals: list[WantedGoal], trajectory: Trajectory, found: TrajectoryPlan) -> Iterator[PointSolution]:
    """Yields the solution of each point of a planned trajectory."""
    whole = {"switches": found.switches, "cost": found.cost, **found.proof()}
    for k, solution in enumerate(found.solutions):
        between, goal = trajectory.between(k), goals[trajectory.next(k)]
        position = trajectory.positions[k].tolist() if between else goal.position
        yield PointSolution(position, goal.orientation, solution, between, whole)


def as_arrays(search: GoalSearch, goals: list[WantedGoal]) -> TipGoals:
    """Returns goals as arrays with their tolerances; the orientation tolerance is infinite without an orientation."""
    from controller.motion.plans.whole import TipGoals

    positions = np.array([goal.position for goal in goals], dtype=np.float64)
    rotations = [np.eye(3) if goal.orientation is None else goal.target()[:3, :3] for goal in goals]
    turns = [np.inf if goal.orientation is None else search.angle_tolerance for goal in goals]
    return TipGoals(positions, np.full(len(goals), search.tolerance), np.array(rotations), np.array(turns))
