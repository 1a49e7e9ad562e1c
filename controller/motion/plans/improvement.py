"""Improves a plan while the arm moves: look-ahead decides each point shortly before its actuators switch."""

import time
from collections.abc import Iterator

import numpy as np

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.lookahead import LookAhead
from hyperbit.controller.motion.plans.plan import TrajectoryPlan
from hyperbit.controller.motion.plans.transitions import TransitionPlanner

MARGIN = 0.1  # [s] between the decision of a point and its first switch, at least
BATCH = 4  # points staged at a time: staging one may take some hundredths of a second, the next are due first


def changed_points(old: TrajectoryPlan, new: TrajectoryPlan) -> slice | None:
    """Returns the points whose transitions differ between two plans; None if all stages are the same."""
    pairs = enumerate(zip(old.transitions, new.transitions, strict=True))
    staged = [k for k, (a, b) in pairs if a is not b]  # others are the same objects
    differ = (k for k in staged if not np.array_equal(old.transitions[k].stages, new.transitions[k].stages))
    first = next(differ, None)
    return None if first is None else slice(first, staged[-1] + 1)


class Improvement:
    """Improves a plan from its second point on; the arm already moves to the first.

    Args:
        planner: of the transitions of the plan's trajectory.
        plan: to improve.
        start: t = 0 of the trajectory [s, monotonic clock]; infinite: no point is ever due.
    """

    def __init__(self, planner: TransitionPlanner, plan: TrajectoryPlan, start: float = np.inf) -> None:
        self._planner, self._plan, self._start = planner, plan, start
        self._longest = 0.0  # to extend to a point, to stage and to check [s]; nothing is decided meanwhile

    def plans(self) -> Iterator[TrajectoryPlan]:
        """Yields the plan again and again, improved whenever more points are decided, so that the caller can act.

        A point is due when only MARGIN and the longest time of one iteration are left before its first switch. If an
        iteration takes longer, the point keeps its earlier plan, which is as accurate but may switch more.
        """
        trajectory, handed_over = self._plan.trajectory, 0
        ahead = LookAhead(self._planner.points, self._plan.solutions[0].configuration, 1)
        between, actuators = np.diff(trajectory.times, prepend=-np.inf), len(self._planner.solver.manipulator.actuators)
        strict = any(transition.strict for transition in self._plan.transitions)
        earliest = trajectory.times - self._planner.pace.longest(between, actuators, strict)
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
                self._improve(handed_over + 1, decided[handed_over : handed_over + BATCH])
                handed_over = min(handed_over + BATCH, len(decided))
                yield self._plan
                self._longest = max(self._longest, extended + time.perf_counter() - began)
                if handed_over == len(decided):
                    break

    def _improve(self, first: int, configurations: list[Configuration]) -> None:
        """Puts configurations into the plan from point `first` on."""
        if configurations:
            self._plan = self._plan.improved(self._planner, first, configurations)
