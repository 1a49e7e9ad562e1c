"""Plans of trajectories, point by point: each configuration is searched from the one before."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.plans.plan import TrajectoryPlan, solution_of, transition_to
from controller.motion.stages.pacing import Blocked, Pace, Staged
from controller.motion.stages.stage_sequencer import DETOUR_TIME
from controller.motion.trajectory import Trajectory
from controller.refusals.reasons import Reason
from controller.refusals.refusal import Refusal
from controller.search.method import MINIMUM_SWITCH, Method
from controller.search.solution import Solution
from controller.search.solver import DEADLINE, Solver
from controller.search.target import distance, within

# Time for all searches of a trajectory [s]. It is short because the arm waits. A part of it is reserved for one first
# answer a point, which is used when the rest of the time is over. Look-ahead computes the deviation of these later.
PLANNING_TIME, FIRST_ANSWER = 0.03, 0.0002

ALTERNATIVE_TIME, ALTERNATIVES = 0.25, 32  # time [s] and number of other configurations if the cheapest is blocked

AT_ONCE = Pace(0.0)


def plan(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    method: Method,
    proceed: Callable[[], None] = lambda: None,
    pace: Pace = AT_ONCE,
    seconds: float = PLANNING_TIME,
) -> TrajectoryPlan:
    """Returns the plan of a trajectory.

    Args:
        solver: of the arm.
        trajectory: the goal.
        previous: configuration of the arm at the start, shape (B,).
        method: the search algorithm.
        proceed: called before each point; a Refusal that it raises ends the planning.
        pace: of the transitions.
        seconds: time for the searches of all points [s].

    Raises:
        Refusal: a point is out of reach (the message gives the nearest one found), no collision-free transition was
            found, the time is too short, or the arm collides where it stands.
    """
    if solver.clearance is not None and (where := solver.clearance.where(previous)) is not None:
        raise Refusal(Reason.ARM_IN_OBSTACLE, collision=where)
    solutions, transitions = list[Solution](), list[Staged]()
    reserved = min(FIRST_ANSWER * len(trajectory.times), 0.8 * seconds)
    until = time.perf_counter() + seconds - reserved
    longest = max(DEADLINE, seconds / len(trajectory.times))
    for k, position in enumerate(trajectory.positions):
        proceed()
        goal, tolerance, turn = trajectory.goal(k), float(trajectory.tolerances[k]), float(trajectory.turns[k])
        if trajectory.between(k) and (same := same_configuration(solutions[-1], position, tolerance)) is not None:
            transitions.append(replace(transitions[-1], stages=transitions[-1].stages[-1:], deviation_source=0.0))
            solutions.append(same)
            continue
        remaining = max(until - time.perf_counter(), 0.0)
        with_deviation = remaining > 0 or method != MINIMUM_SWITCH
        if k in trajectory.fixed:
            solution = fixed_point(solver, trajectory, previous, k)
            try:
                solution, transition = transition_to(
                    solver, trajectory, previous, solution, k, pace, with_deviation, DETOUR_TIME
                )
            except Blocked as blocked:
                raise Refusal(Reason.NO_CLEAR_PATH, where=place(trajectory, k), blocked=str(blocked)) from None
            solutions.append(solution)
            transitions.append(transition)
            previous = solution.configuration
            continue
        solution = solver.solve(goal, previous, tolerance, method, min(longest, remaining), turn)
        if not solution.within_tolerance:
            raise out_of_reach(trajectory, k, solution)
        try:
            solution, transition = transition_to(solver, trajectory, previous, solution, k, pace, with_deviation)
        except Blocked as blocked:
            solution, transition = alternative(solver, trajectory, previous, solution, k, pace, blocked)
        except Refusal:  # a search with more time may find fewer switches, which need less time
            solution = solver.solve(goal, previous, tolerance, method, angle_tolerance=turn)
            try:
                solution, transition = transition_to(solver, trajectory, previous, solution, k, pace)
            except Blocked as blocked:
                solution, transition = alternative(solver, trajectory, previous, solution, k, pace, blocked)
        solutions.append(solution)
        transitions.append(transition)
        previous = solution.configuration
    return TrajectoryPlan(trajectory, tuple(solutions), tuple(transitions), solutions[0].bound)


def alternative(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    cheapest: Solution,
    k: int,
    pace: Pace,
    blocked: Blocked,
) -> tuple[Solution, Staged]:
    """Returns another configuration for point k, or a detour to the cheapest, because the cheapest is blocked.

    Raises:
        Refusal: none was found in ALTERNATIVE_TIME; the message names what blocks the cheapest.
    """
    goal, tolerance, turn = trajectory.goal(k), float(trajectory.tolerances[k]), float(trajectory.turns[k])
    until = time.perf_counter() + ALTERNATIVE_TIME
    others, costs = solver.candidates(goal, previous, tolerance, ALTERNATIVES, turn)
    methods: tuple[Method, ...] = ("ipop-fewest-switches", "pop")
    ranked = [others[n] for n in np.argsort(costs, kind="stable")]
    ranked += [
        solver.solve(goal, previous, tolerance, method, angle_tolerance=turn).configuration for method in methods
    ]
    distinct = {c.tobytes(): c for c in (cheapest.configuration, *ranked)}
    found = [solution_of(solver, trajectory, previous, c, k, cheapest.bound) for c in distinct.values()]
    served = [solution for solution in found if solution.within_tolerance]
    for patience, solutions in ((0.0, served[1:]), (DETOUR_TIME, served)):  # detours last
        for solution in solutions:
            if time.perf_counter() > until:
                break
            try:
                return transition_to(solver, trajectory, previous, solution, k, pace, patience=patience)
            except (Blocked, Refusal):
                continue
    raise Refusal(Reason.NO_CLEAR_PATH, where=place(trajectory, k), blocked=str(blocked)) from None


def fixed_point(solver: Solver, trajectory: Trajectory, previous: Configuration, point: int) -> Solution:
    """Returns the solution of a point that the goal gives as a configuration.

    Raises:
        Refusal: a locked actuator excludes the configuration, or the arm collides in it.
    """
    try:
        configuration = solver.manipulator.configuration(trajectory.fixed[point])
    except ValueError as error:
        raise Refusal(Reason.LOCKED_CONFIGURATION, where=place(trajectory, point), error=str(error)) from None
    if solver.clearance is not None and (where := solver.clearance.where(configuration)) is not None:
        raise Refusal(Reason.GOAL_IN_OBSTACLE, where=place(trajectory, point), collision=where)
    return solution_of(solver, trajectory, previous, configuration, point)


def same_configuration(solution: Solution, goal: NDArray[np.float64], tolerance: float) -> Solution | None:
    """Returns the solution of the next point with the same configuration; None if the point is not within tolerance."""
    frame = np.eye(4)
    frame[: len(goal), 3] = goal
    if not within(solution.tip, frame, tolerance, np.inf):
        return None
    return replace(solution, error=distance(solution.tip, frame), switches=0, seconds=0.0, cost=0.0, bound=0.0)


def out_of_reach(trajectory: Trajectory, point: int, nearest: Solution) -> Refusal:
    """Returns the refusal of a point for which no configuration within tolerance was found."""
    goal, tolerance = trajectory.positions[point], trajectory.tolerances[point]
    bias = trajectory.bias
    wanted = ", ".join(f"{x:g}" for x in (goal if bias is None else goal + bias))
    tip = ", ".join(f"{x:.4f}" for x in nearest.tip[: len(goal), 3])
    if (turn := trajectory.turns[point]) < np.inf:
        away = f"{nearest.error:.4f} away and turned {nearest.angle:.4f} rad, tolerances {tolerance:g} and {turn:g}"
        turned, found = " in this orientation", f"the nearest pose found is at ({tip}), {away}"
    else:
        away = f"{nearest.error:.4f} away, tolerance {tolerance:g}"
        turned, found = "", f"the nearest point found is ({tip}), {away}"
    if bias is not None and bias.any():
        found += f"; the tip bias is ({', '.join(f'{x:.4f}' for x in bias)})"
    where = place(trajectory, point)
    if nearest.certificate == "unreachable":
        return Refusal(Reason.OUT_OF_REACH, where=where, position=wanted, turned=turned, nearest=found)
    return Refusal(Reason.NOT_FOUND, where=where, position=wanted, turned=turned, nearest=found)


def place(trajectory: Trajectory, point: int) -> str:
    """Returns the name of a point in messages."""
    if trajectory.between(point):
        last = trajectory.last(point)
        return f"waypoints[{last}] to waypoints[{last + 1}]"
    return f"waypoints[{trajectory.last(point)}].{'configuration' if point in trajectory.fixed else 'position'}"
