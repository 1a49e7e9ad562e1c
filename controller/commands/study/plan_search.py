"""Searches for the goals of `plan`: for each goal separately, or for all goals as one trajectory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.commands.common import CommandFailed, densities_of, errors
from hyperbit.controller.commands.study.plan_rows import PlanOptions, PointSolution, WantedGoal
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.method import Method

if TYPE_CHECKING:  # the search's kernels take a second to import
    from hyperbit.controller.motion.plans.whole import TipGoals
    from hyperbit.controller.search.search_time import SearchTime
    from hyperbit.controller.search.solver import Solver


class GoalSearch(NamedTuple):
    """A prepared solver of the reduced arm, and how to search with it: the options, or the arm's own values."""

    arm: Arm
    solver: Solver
    tolerance: float
    angle_tolerance: float  # [rad]
    method: Method
    options: PlanOptions

    @property
    def allowed(self) -> SearchTime:
        """Time or work of the search for one goal."""
        from hyperbit.controller.search.search_time import TIMEOUT, search_effort, search_time

        if self.options.effort is not None:
            return search_effort(self.options.effort)
        return search_time(TIMEOUT, self.arm.settings.planning.seconds_per_switch, self.options.deadline)


def prepared_search(arm: Arm, options: PlanOptions, *, silent: bool) -> GoalSearch:
    """Returns a search with the options; `silent` hides the progress bar."""
    from hyperbit.controller.search.solver import Solver

    solver = Solver(arm.reduced, densities_of(arm, silent=silent), weights_of(arm), arm.clearance(arm.reduced))
    solver.prepare()
    tolerances = options.tolerance or arm.tolerance, options.angle_tolerance or arm.angle_tolerance
    return GoalSearch(arm, solver, *tolerances, options.method or arm.settings.method, options)


def described(search: GoalSearch, start: Configuration, configuration: Configuration) -> PointSolution:
    """Returns a configuration as the solution of its own tip position, without a search."""
    position = search.solver.manipulator.tip(configuration)[: search.solver.manipulator.dimension, 3]
    target = search.solver.target(position, search.tolerance)
    solution = search.solver.described(configuration, target, start)
    return PointSolution(position.tolist(), None, solution)


def search_one(search: GoalSearch, goal: WantedGoal, start: Configuration) -> PointSolution:
    """Returns the solution of a goal, searched from its own previous configuration, or from `start` (B,)."""
    own = start if goal.previous is None else goal.previous
    angle_tolerance = np.inf if goal.orientation is None else search.angle_tolerance
    target = search.solver.target(goal.target(), search.tolerance, angle_tolerance)
    found = search.solver.solve(target, own, search.method, search.allowed)
    found = search.solver.explained(found, target, own, search.allowed)
    return PointSolution(goal.position, goal.orientation, found)


def follow(
    search: GoalSearch, goals: list[WantedGoal], start: Configuration, processes: int
) -> Iterator[PointSolution]:
    """Yields the solution of each point of a trajectory from `start` (B,), as the daemon answers `plan`.

    The trajectory leaves enough time for all switches. Goals that cannot be planned as one trajectory are searched
    separately, each from the solution before. Lines between goals that cannot be followed end the command. Some
    processes share the processors.
    """
    from hyperbit.controller.motion.plans.transitions import TransitionPlanner
    from hyperbit.controller.motion.plans.whole import PROOF_TIME, Means, first_time, plan_whole, proof_means, unhurried
    from hyperbit.controller.motion.stages.pacing import pace_of
    from hyperbit.controller.search.search_time import search_time

    options, pace, planning = search.options, pace_of(search.arm.settings), search.arm.settings.planning
    start = start if goals[0].previous is None else goals[0].previous
    try:
        trajectory = unhurried(as_arrays(search, goals), pace, options.path_tolerance)
        planner = TransitionPlanner(search.solver, trajectory, pace)
        first = search_time(first_time(trajectory), planning.seconds_per_switch, options.deadline)
        whole_time, means = options.deadline, Means()
        if options.prove:
            whole_time, means = options.deadline or PROOF_TIME, proof_means(processes)
        found = plan_whole(planner, start, search.method, first, whole_time, means)
    except Refusal as refusal:
        if options.path_tolerance is not None:
            raise CommandFailed(str(refusal)) from None
        errors.print(f"no plan of the whole trajectory: {refusal}; each goal is searched separately")
        for goal in goals:
            point = search_one(search, goal._replace(previous=None), start)
            start = point.solution.configuration
            yield point
        return
    whole = {"switches": found.switches, "cost": found.cost, **found.proof(), "gap": found.gap}
    for k, solution in enumerate(found.solutions):
        between, goal = trajectory.between(k), goals[trajectory.next(k)]
        position = trajectory.positions[k].tolist() if between else goal.position
        yield PointSolution(position, goal.orientation, solution, between, whole)


def trajectories(goals: Iterable[WantedGoal]) -> Iterator[list[WantedGoal]]:
    """Yields the goals of each trajectory; a goal with a previous configuration begins a new one."""
    part = list[WantedGoal]()
    for goal in goals:
        if part and goal.previous is not None:
            yield part
            part = []
        part.append(goal)
    if part:
        yield part


def as_arrays(search: GoalSearch, goals: list[WantedGoal]) -> TipGoals:
    """Returns goals as arrays with their tolerances; the orientation tolerance is infinite without an orientation."""
    from hyperbit.controller.motion.plans.whole import TipGoals

    positions = np.array([goal.position for goal in goals], dtype=np.float64)
    rotations = [np.eye(3) if goal.orientation is None else goal.target()[:3, :3] for goal in goals]
    turns = [np.inf if goal.orientation is None else search.angle_tolerance for goal in goals]
    return TipGoals(positions, np.full(len(goals), search.tolerance), np.array(rotations), np.array(turns))
