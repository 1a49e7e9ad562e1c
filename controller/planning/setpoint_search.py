"""Searches the configuration for a set-point, and the stages to it. Belongs to one thread."""

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
FAR = 10.0  # tolerances; IPOP missed none of 2000 reachable positions by more than 2
ALTERNATIVE_TIME, ALTERNATIVES = 0.05, 16  # time [s] and number of other configurations if the cheapest is blocked

Vector = NDArray[np.float64]


class Query(NamedTuple):
    """One search.

    Attributes:
        solver: of the arm reduced by locked actuators.
        keep_out: the obstacles that the solver avoids.
        commanded: actuator states from which stages begin, shape (A,).
        start: configuration to plan from, of the solver's arm, shape (B,).
        goal: position of the computed tip, shape (dimension,).
        tolerance: greatest distance from the goal.
    """

    solver: Solver
    keep_out: KeepOutSet
    commanded: States
    start: Configuration
    goal: Vector
    tolerance: float


class SetpointSearch:
    """Searches that fit between two set-points.

    Args:
        arm: the whole arm.
        pace: of its transitions.
    """

    def __init__(self, arm: Arm, pace: Pace) -> None:
        self._arm, self._pace = arm, pace

    def find(self, query: Query) -> Solution:
        """Searches by the arm's method; returns IPOP's result if it misses by far, as longer searches miss, too."""
        method, (solver, _, _, start, goal, tolerance) = self._arm.settings.method, query
        if method == "minimum-switch":
            first = solver.solve(goal, start, tolerance, "ipop-fewest-switches", patience=SEARCH_TIME)
            if first.error > FAR * tolerance:
                return first
        return solver.solve(goal, start, tolerance, method, SEARCH_TIME, patience=SEARCH_TIME)

    def stages(self, query: Query, end: Configuration) -> States:
        """Returns the stages (k, A) to a configuration, or to another one within tolerance if the first is blocked.

        Raises:
            Blocked: no collision-free stages were found.
        """
        solver, keep_out, commanded, start, goal, tolerance = query
        reduced = solver.manipulator
        if keep_out.free:
            most = self._pace.inrush or len(commanded)
            return restage(self._arm.manipulator, commanded, reduced.actuator_states(end)[None], most)
        until, obstruction = time.perf_counter() + ALTERNATIVE_TIME, None
        for configuration in (end, *solver.candidates(goal, start, tolerance, ALTERNATIVES)[0]):
            try:
                sweep = sweep_for(solver)
                stages = self._pace.staged(reduced, start, configuration, None, False, sweep, patience=0.0).stages
                if (collision := keep_out.first_collision(commanded, stages)) is None:
                    return stages
                obstruction = obstruction or Blocked(collision)
            except Blocked as blocked:
                obstruction = obstruction or blocked
            if time.perf_counter() > until:
                break
        raise obstruction or Blocked("no collision-free transition was found")
