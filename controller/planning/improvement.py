"""Better plans while the arm moves: look-ahead over the points still to come, each in time for its own."""

import time
from collections.abc import Iterator

import numpy as np

from controller.manipulator.manipulator import Configuration
from controller.motion.lookahead import LookAhead
from controller.motion.pacing import Pace
from controller.motion.plan import Plan
from controller.search.solver import Solver

MARGIN = 0.1  # [s] before a point's actuators switch, at which its configuration is handed over at the latest
BATCH = 4  # points staged at a time: each may take some hundredths of a second, and the next is due soonest


class Improvement:
    """Improves a plan from its second point on; the arm moves to the first already.

    Args:
        solver: of the arm.
        plan: to improve.
        pace: of the arm's transitions.
        start: t = 0 of its trajectory [s on the monotonic clock]; infinite: nothing is due.
    """

    def __init__(self, solver: Solver, plan: Plan, pace: Pace, start: float = np.inf) -> None:
        self._solver, self._plan, self._pace, self._start = solver, plan, pace, start
        self._longest = 0.0  # time of extending to a point and staging [s], in which nothing is decided

    def plans(self) -> Iterator[Plan]:
        """Yields a better plan whenever more is decided, and the same again in between, so that others have a say.

        A point is decided when the time that was needed so far for the next one, and MARGIN, are left before its
        actuators switch. If the next one takes longer, the point may be reached by the plan before: as near, with more
        switches.
        """
        trajectory, told = self._plan.trajectory, 0
        first = self._plan.solutions[0].configuration
        ahead = LookAhead(self._solver, first, trajectory, 1)
        between, actuators = np.diff(trajectory.times, prepend=-np.inf), len(self._solver.manipulator.actuators)
        strict = any(transition.strict for transition in self._plan.transitions)
        earliest = trajectory.times - self._pace.longest(between, actuators, strict)
        for k in range(1, len(trajectory.times)):
            began = time.perf_counter()
            ahead.extend()
            extended = time.perf_counter() - began
            soon = time.monotonic() + MARGIN + max(self._longest, extended) - self._start
            due = int(np.searchsorted(earliest, soon)) - 1
            ahead.decide(k if k == len(trajectory.times) - 1 else min(due, k))
            decided = ahead.decided()
            while True:
                began = time.perf_counter()
                self._improve(told + 1, decided[told : told + BATCH])
                self._longest = max(self._longest, extended + time.perf_counter() - began)
                told = min(told + BATCH, len(decided))
                yield self._plan
                if told == len(decided):
                    break

    def _improve(self, first: int, configurations: list[Configuration]) -> None:
        """Takes configurations from point `first` on, if there are any."""
        if configurations:
            self._plan = self._plan.improved(self._solver, self._pace, first, configurations)
