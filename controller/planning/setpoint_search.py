"""The configuration for a set-point, and the stages to it. One thread's."""

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.config import Arm
from controller.manipulator.manipulator import Configuration
from controller.motion.pacing import Blocked, Pace
from controller.motion.plan import sweep_for
from controller.motion.restaging import restage
from controller.planning.arm_state import States
from controller.planning.keep_out import KeepOutSet
from controller.search.solution import Solution
from controller.search.solver import Solver

SEARCH_TIME = 0.01  # [s] for one search; it is never worse than IPOP
FAR = 10.0  # tolerances; among 2000 positions that the arm reaches, IPOP misses none by more than 2
ASIDE, OTHERS = 0.05, 16  # [s] for other configurations where the way to the cheapest is barred, and how many

Vector = NDArray[np.float64]


class Query(NamedTuple):
    """What is searched.

    Attributes:
        solver: of the arm reduced by locked actuators.
        keep_out: the obstacles that it keeps clear of.
        commanded: actuator states that stages begin from, shape (A,).
        start: configuration to plan from, of the solver's arm, shape (B,).
        goal: position of the computed tip, shape (dimension,).
        tolerance: greatest distance from it.
    """

    solver: Solver
    keep_out: KeepOutSet
    commanded: States
    start: Configuration
    goal: Vector
    tolerance: float


class SetpointSearch:
    """Searches within the time between two set-points.

    Args:
        arm: the whole arm.
        pace: of its transitions.
    """

    def __init__(self, arm: Arm, pace: Pace) -> None:
        self._arm, self._pace = arm, pace

    def find(self, query: Query) -> Solution:
        """Returns what the arm's method finds, or IPOP where that misses by far: a longer search would, too."""
        method, (solver, _, _, start, goal, tolerance) = self._arm.settings.method, query
        if method == "minimum-switch":
            first = solver.solve(goal, start, tolerance, "ipop-fewest-switches", patience=SEARCH_TIME)
            if first.error > FAR * tolerance:
                return first
        return solver.solve(goal, start, tolerance, method, SEARCH_TIME, patience=SEARCH_TIME)

    def stages(self, query: Query, end: Configuration) -> States:
        """Returns the stages (k, A) to a configuration, or to another within the tolerance if its way is barred.

        Raises:
            Blocked: no way was found on which nothing is touched.
        """
        solver, keep_out, commanded, start, goal, tolerance = query
        reduced = solver.manipulator
        if keep_out.free:
            most = self._pace.inrush or len(commanded)
            return restage(self._arm.manipulator, commanded, reduced.actuator_states(end)[None], most)
        until, barred = time.perf_counter() + ASIDE, None
        for configuration in (end, *solver.candidates(goal, start, tolerance, OTHERS)[0]):
            try:
                sweep = sweep_for(solver)
                stages = self._pace.staged(reduced, start, configuration, None, False, sweep, patience=0.0).stages
                if (touched := keep_out.touched(commanded, stages)) is None:
                    return stages
                barred = barred or Blocked(touched)
            except Blocked as blocked:
                barred = barred or blocked
            if time.perf_counter() > until:
                break
        raise barred or Blocked("no way was found")
