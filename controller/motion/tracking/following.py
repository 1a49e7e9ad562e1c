"""Followed set-points: the search for the configuration, and the stages to it."""

from typing import NamedTuple

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.plans.transitions import sweep_for
from hyperbit.controller.motion.stages.pacing import Blocked, Pace, Stager
from hyperbit.controller.motion.stages.program import restage
from hyperbit.controller.obstacles.keep_out import KeepOutSet, States
from hyperbit.controller.search.method import MINIMUM_SWITCH, Method
from hyperbit.controller.search.search_time import SearchTime
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.search.target import SearchTarget

SEARCH_TIME = SearchTime(0.01)  # for one search; it is never worse than IPOP
FAR = 10.0  # tolerances; IPOP missed none of 2000 reachable positions by more than 2
ALTERNATIVE_TIME, ALTERNATIVES = 0.05, 16  # time [s] and number of other configurations if the cheapest is blocked


class SetpointQuery(NamedTuple):
    """One search."""

    solver: Solver  # of the arm reduced by locked actuators
    keep_out: KeepOutSet  # the obstacles that the solver avoids, for the whole arm
    commanded: States  # actuator states from which stages begin, shape (A,)
    start: Configuration  # configuration to plan from, of the solver's arm, shape (B,)
    target: SearchTarget  # position of the computed tip, and greatest distance from it


def find(query: SetpointQuery, method: Method) -> Solution:
    """Searches by a method; returns IPOP's result if it misses by far, as longer searches miss, too."""
    solver, target, start = query.solver, query.target, query.start
    if method == MINIMUM_SWITCH:
        first = solver.solve(target, start, "ipop-fewest-switches", SEARCH_TIME)
        if first.error > FAR * target.tolerance:
            return first
    return solver.solve(target, start, method, SEARCH_TIME)


def stages_to(query: SetpointQuery, end: Configuration, whole: Manipulator, pace: Pace) -> States:
    """Returns the stages (k, A) to a configuration, or to another one within tolerance if the first is blocked.

    Raises:
        Blocked: no collision-free stages were found.
    """
    solver, keep_out, commanded, start, target = query
    reduced = solver.manipulator
    if keep_out.free:
        most = pace.inrush or len(commanded)
        return restage(whole, commanded, reduced.actuator_states(end)[None], most)
    deadline, obstruction = solver.clock.now() + ALTERNATIVE_TIME, None
    stager = Stager(reduced, pace, sweep_for(solver))
    for configuration in (end, *solver.candidates(target, start, ALTERNATIVES)[0]):
        try:
            stages = stager.staged(start, configuration, None, with_deviation=False).stages
            if (collision := keep_out.first_collision(commanded, stages)) is None:
                return stages
            obstruction = obstruction or Blocked(collision)
        except Blocked as blocked:
            obstruction = obstruction or blocked
        if solver.clock.now() > deadline:
            break
    raise obstruction or Blocked("no collision-free transition was found")
