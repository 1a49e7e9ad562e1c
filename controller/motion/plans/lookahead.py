"""Look-ahead: beam search for the cheapest sequence of configurations along a trajectory, while the arm already moves.

A label is a configuration at one point with the cheapest known path to it. The WIDTH best labels of each point are
extended to the next. After some points all labels share the beginning of their paths; that beginning is decided.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.plan import TrajectoryPlan
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.plans.transitions import TransitionPlanner

WIDTH = 64  # labels kept at a point
MOST = 32  # successors of a label
SPREAD = 1.0  # greatest extra cost of a label's successor over its cheapest one, in least weights
MARGIN = 0.1  # [s] between the decision of a point and its first switch, at least
BATCH = 4  # points staged at a time: staging one may take some hundredths of a second, the next are due first


@dataclass(frozen=True, eq=False)
class PathLabel:
    """A configuration at one point, and the path to it."""

    cost: float  # weighted switches of the path
    configuration: Configuration  # at the end of the path, shape (B,)
    until: int  # the first later point that the configuration does not serve, up to FARTHEST ahead
    before: PathLabel | None  # label at the point before; None at the first point, and where the path is decided


class LookAhead:
    """Paths along a trajectory, extended point by point.

    All paths begin in the configuration `start` (B,), before the point `first`. A configuration stays as long as it
    serves. Switching sooner saves nothing, because costs obey the triangle inequality.
    """

    def __init__(self, points: TrajectoryPoints, start: Configuration, first: int = 0) -> None:
        self._points, self._solver, self._first = points, points.solver, first
        self._labels = [PathLabel(0.0, np.array(start, dtype=np.int64), 0, None)]
        self._decided: list[Configuration] = []  # after `start`
        self._next = 0

    def extend(self) -> None:
        """Extends all paths to the next point."""
        best: dict[bytes, PathLabel] = {}
        for label in self._labels:
            for successor in self._successors(label):
                key = successor.configuration.tobytes()
                if key not in best or best[key].cost > successor.cost:
                    best[key] = successor
        if not best:  # too far for the small tables: one successor, by the complete search
            label = self._labels[0]
            found = self._solver.solve(self._points[self._first + self._next].target, label.configuration)
            best[b""] = PathLabel(label.cost + found.cost, found.configuration, self._next + 1, label)
        self._next += 1
        # Of two labels of equal cost the one that serves longer is better: a point is worth the mean cost so far.
        price = min(label.cost for label in best.values()) / self._next
        self._labels = sorted(best.values(), key=lambda label: label.cost - price * label.until)[:WIDTH]

    def _successors(self, label: PathLabel) -> list[PathLabel]:
        if label.until > self._next:
            return [PathLabel(label.cost, label.configuration, label.until, label)]
        point = self._points[self._first + self._next]
        if (given := point.configuration) is not None:
            cost = float(self._solver.cost(given, label.configuration))
            return [PathLabel(label.cost + cost, given, self._until(given[None])[0], label)]
        configurations, costs, _ = self._solver.candidates(point.target, label.configuration, MOST)
        if len(costs) == 0:
            return []
        near = costs <= costs.min() + SPREAD * self._solver.least_weight
        until = self._until(configurations[near])
        return [
            PathLabel(label.cost + cost, configuration, last, label)
            for configuration, cost, last in zip(configurations[near], costs[near].tolist(), until, strict=True)
        ]

    def _until(self, configurations: NDArray[np.int64]) -> list[int]:
        """Returns the first point after the next that configurations (m,) of the next point do not serve."""
        following = self._next + 1
        return [following + n for n in self._points.count_served(configurations, self._first + following).tolist()]

    def decided(self) -> list[Configuration]:
        """Returns the configurations after the start that all paths share."""
        return self._commit(self._common())

    def decide(self, count: int) -> list[Configuration]:
        """Returns the first `count` configurations of the cheapest path; drops the labels whose paths differ there."""
        if count > len(self._decided):
            steps = count - len(self._decided)
            chosen = trace(self._labels[0])[steps]
            self._labels = [label for label in self._labels if trace(label)[steps] is chosen]
            self._commit(steps)
        return self._decided[:count]

    def _common(self) -> int:
        paths = [trace(label) for label in self._labels]
        return sum(all(path[k] is paths[0][k] for path in paths) for k in range(1, len(paths[0])))

    def _commit(self, steps: int) -> list[Configuration]:
        """Appends the first steps of all paths, which share them, to the decided ones; cuts the paths there."""
        if steps > 0:
            path = trace(self._labels[0])
            self._decided += [label.configuration for label in path[1 : steps + 1]]
            object.__setattr__(path[steps], "before", None)
        return self._decided


def trace(label: PathLabel) -> list[PathLabel]:
    """Returns the labels of a path, from its beginning to the given label."""
    path = [label]
    while path[-1].before is not None:
        path.append(path[-1].before)
    return path[::-1]


def changed_points(old: TrajectoryPlan, new: TrajectoryPlan) -> slice | None:
    """Returns the points whose transitions differ between two plans; None if all stages are the same."""
    pairs = enumerate(zip(old.transitions, new.transitions, strict=True))
    staged = [k for k, (a, b) in pairs if a is not b]  # others are the same objects
    differ = (k for k in staged if not np.array_equal(old.transitions[k].stages, new.transitions[k].stages))
    first = next(differ, None)
    return None if first is None else slice(first, staged[-1] + 1)


class Improvement:
    """Improves a plan from its second point on; the arm already moves to the first.

    `start` is t = 0 of the trajectory [s, monotonic clock]; infinite: no point is ever due.
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
