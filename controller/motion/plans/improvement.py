"""Improvement of a plan while the arm already moves: sections of what has not begun are searched again and again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.plan import TrajectoryPlan
from hyperbit.controller.motion.plans.points import TrajectoryPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner

ROUNDS = (4, 16, 64), (64, 256), (64, 256), (1024,)  # widths of layers; each round goes through the whole trajectory
SECTION = 64  # points that are searched at once; the next section begins in the middle of it
MARGIN = 0.1  # [s] between the change of a point and its first switch, at least
BATCH = 4  # points staged at a time: staging one may take some hundredths of a second, the next are due first
PRICE = 1e-4  # [s] of a search for each place in each layer, at first
MEMORY = 1 << 20  # see LabelSetting


class Improvement:
    """Improves a plan from its second point on; the arm already moves to the first.

    `start` is t = 0 of the trajectory [s, monotonic clock]; infinite: no point is ever due. `stop` is called
    repeatedly; if it returns true, the improvement ends. What it raises ends the improvement, too.
    """

    def __init__(
        self,
        planner: TransitionPlanner,
        plan: TrajectoryPlan,
        start: float = np.inf,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self._planner, self._plan, self._start, self._stop = planner, plan, start, stop
        times, actuators = plan.trajectory.times, len(planner.solver.manipulator.actuators)
        strict = any(transition.strict for transition in plan.transitions)
        between = np.diff(times, prepend=-np.inf)
        self._earliest = times - planner.pace.longest(between, actuators, strict)  # of each point's first switch
        self._batch = BATCH if strict or planner.pace.inrush is not None else SECTION
        self._price, self._staging = PRICE, 0.0  # [s] of a place, and of the stages of a batch

    def plans(self) -> Iterator[TrajectoryPlan]:
        """Yields the plan again and again, improved, so that the caller can act.

        A point is left as it is from the time on when only MARGIN and the expected time of one search are left before
        its first switch.
        """
        count = len(self._earliest)
        for widths in ROUNDS:
            first = 1
            while first < count:
                for width in widths:
                    first = max(first, self._first(self._price * width * min(SECTION, count - first) + self._staging))
                    yield from self._search(first, min(first + SECTION, count), width)
                    if self._stop():
                        return
                first += SECTION // 2 if first + SECTION < count else SECTION

    def _first(self, seconds: float) -> int:
        """Returns the first point that is not due when some time [s] has passed."""
        soon = self._planner.solver.clock.now() + MARGIN + seconds - self._start
        return int(np.searchsorted(self._earliest, soon))

    def _search(self, first: int, end: int, width: int) -> Iterator[TrajectoryPlan]:
        """Yields the plan with better configurations from point `first` up to `end`, if layers of a width find any."""
        if first >= end:
            return
        planner, solutions = self._planner, self._plan.solutions
        clock = planner.solver.clock
        began = clock.now()
        points = [planner.points[k] for k in range(first, end)]
        rows = np.array([solution.configuration for solution in solutions[first : end + 1]])
        if end < len(solutions):  # the section ends in the plan's next configuration
            states = planner.solver.manipulator.actuator_states(rows[-1])
            given = replace(planner.trajectory, fixed={**planner.trajectory.fixed, end: states})
            points.append(TrajectoryPoint(end, given, planner.points[end].target))
        before = solutions[first - 1].configuration
        search = LabelSetting(planner.solver, points, before, self._stop, memory=MEMORY)
        search.offer(rows, float(planner.solver.cost(rows, np.vstack([before, rows[:-1]])).sum()))
        if not search.try_all(PRICE * width * len(points)):
            search.narrow(width)
        self._price = (clock.now() - began) / (width * len(points))
        if (found := search.best.configurations) is None:
            return
        changed = np.flatnonzero((found != rows).any(axis=1)).tolist()
        for k in range(changed[0], changed[-1] + 1, self._batch) if changed else ():
            began = clock.now()
            some = list(found[k : min(k + self._batch, changed[-1] + 1)])
            self._plan = self._plan.improved(planner, first + k, some)
            self._staging = max(self._staging, clock.now() - began)
            yield self._plan


def changed_points(old: TrajectoryPlan, new: TrajectoryPlan) -> slice | None:
    """Returns the points whose transitions differ between two plans; None if all stages are the same."""
    pairs = enumerate(zip(old.transitions, new.transitions, strict=True))
    staged = [k for k, (a, b) in pairs if a is not b]  # others are the same objects
    differ = (k for k in staged if not np.array_equal(old.transitions[k].stages, new.transitions[k].stages))
    first = next(differ, None)
    return None if first is None else slice(first, staged[-1] + 1)
