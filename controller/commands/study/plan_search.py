"""Searches for the goals of `plan`: for each goal separately, or for all goals as one trajectory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.commands.common import CommandFailed, densities_of, errors
from hyperbit.controller.commands.study.plan_rows import PlanOptions, PointSolution, WantedGoal
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.method import Method

if TYPE_CHECKING:  # the search's kernels take a second to import
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

    def asked(self, goal: WantedGoal) -> tuple[NDArray[np.float64], float, float]:
        """Returns position or frame of a goal, and its tolerances; that of an orientation is infinite without one."""
        return goal.target(), self.tolerance, np.inf if goal.orientation is None else self.angle_tolerance


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
    target = search.solver.target(*search.asked(goal))
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
    from hyperbit.controller.motion.plans.whole import plan_whole, proof_means, tip_goals, unhurried
    from hyperbit.controller.motion.stages.pacing import pace_of

    options, pace, planning = search.options, pace_of(search.arm.settings), search.arm.settings.planning
    start = start if goals[0].previous is None else goals[0].previous
    try:
        asked = tip_goals((search.asked(goal) for goal in goals), search.arm.manipulator.dimension)
        trajectory = unhurried(asked, pace, options.path_tolerance)
        planner = TransitionPlanner(search.solver, trajectory, pace)
        proof = proof_means(processes) if options.prove else None
        found = plan_whole(planner, start, search.method, options.deadline, planning.seconds_per_switch, proof)
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
