"""Looking ahead: the sequence of configurations along a trajectory that switches least in all.

Many configurations are kept for each point, each with its cheapest way there, and the cheapest of the ways to the
next point are kept in turn. Ways that lead on soon have their beginning in common: that much is decided.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.trajectory import Trajectory
from controller.search.solver import Solver

WIDTH = 64  # ways kept
MOST = 32  # configurations looked at from each way
FARTHEST = 64  # points ahead, for which it is seen whether a configuration serves
SPREAD = 1.0  # how much dearer than a way's cheapest continuation another may be, in least weights


@dataclass(frozen=True, eq=False)
class Way:
    """A sequence of configurations up to one point.

    Attributes:
        cost: weighted switches from the first configuration on.
        configuration: at its end, shape (B,).
        until: the first point after that for which the configuration does not serve, as far as was looked.
        before: the way to the point before; None at the first.
    """

    cost: float
    configuration: Configuration
    until: int
    before: Way | None


class LookAhead:
    """Ways along a trajectory, extended point by point.

    A configuration is held as long as it serves. To switch sooner saves nothing: what it spares later, the switches
    of a longer way round, is never more than what it costs.

    Args:
        solver: of the arm.
        start: configuration that all ways begin with, shape (B,).
        trajectory: whose points are to be reached after it.
        first: of these points.
    """

    def __init__(self, solver: Solver, start: Configuration, trajectory: Trajectory, first: int = 0) -> None:
        self._solver, self._trajectory, self._first = solver, trajectory, first
        self._ways = [Way(0.0, np.array(start, dtype=np.int64), 0, None)]
        self._decided: list[Configuration] = []  # after `start`
        self._next = 0

    def extend(self) -> None:
        """Leads all ways on to the next point."""
        best: dict[bytes, Way] = {}
        for way in self._ways:
            for onward in self._onward(way):
                key = onward.configuration.tobytes()
                if key not in best or best[key].cost > onward.cost:
                    best[key] = onward
        if not best:  # too far for the small tables: one way on, by the search that goes farther
            way = self._ways[0]
            goal, tolerance, turn = self._goal()
            found = self._solver.solve(goal, way.configuration, tolerance, angle_tolerance=turn)
            best[b""] = Way(way.cost + found.cost, found.configuration, self._next + 1, way)
        self._next += 1
        # Of two ways of one cost the better is that which serves longer: a point costs what it did so far.
        price = min(way.cost for way in best.values()) / self._next
        self._ways = sorted(best.values(), key=lambda way: way.cost - price * way.until)[:WIDTH]

    def _onward(self, way: Way) -> list[Way]:
        if way.until > self._next:
            return [Way(way.cost, way.configuration, way.until, way)]
        goal, tolerance, turn = self._goal()
        if (states := self._trajectory.fixed.get(self._first + self._next)) is not None:
            fixed = self._solver.manipulator.configuration(states)
            described = self._solver.described(fixed, goal, way.configuration, tolerance, turn)
            return [Way(way.cost + described.cost, fixed, self._until(fixed[None])[0], way)]
        configurations, costs = self._solver.candidates(goal, way.configuration, tolerance, MOST, turn)
        if len(costs) == 0:
            return []
        near = costs <= costs.min() + SPREAD * self._solver.least_weight
        until = self._until(configurations[near])
        return [
            Way(way.cost + cost, configuration, last, way)
            for configuration, cost, last in zip(configurations[near], costs[near].tolist(), until, strict=True)
        ]

    def _until(self, configurations: NDArray[np.int64]) -> list[int]:
        """Returns how far configurations (m, B) serve that do so for the next point."""
        following = self._first + self._next + 1
        tips = self._solver.manipulator.tips(configurations)
        served = self._trajectory.serve(tips, slice(following, following + FARTHEST))
        return (self._next + 1 + np.logical_and.accumulate(served, axis=1).sum(axis=1)).tolist()  # type: ignore[no-any-return]

    def _goal(self) -> tuple[NDArray[np.float64], float, float]:
        """Returns the next point, see Solver.solve, and the tolerances of its position and orientation."""
        point, it = self._first + self._next, self._trajectory
        return it.goal(point), float(it.tolerances[point]), float(it.turns[point])

    def decided(self) -> list[Configuration]:
        """Returns the configurations after the start that all ways have in common."""
        return self._settle(self._common())

    def decide(self, count: int) -> list[Configuration]:
        """Returns the first `count` configurations after the start of the cheapest way; ways that differ there end."""
        if count > len(self._decided):
            line = trace(self._ways[0])
            chosen = line[count - len(self._decided)]
            self._ways = [way for way in self._ways if trace(way)[count - len(self._decided)] is chosen]
            self._settle(count - len(self._decided))
        return self._decided[:count]

    def _common(self) -> int:
        """Returns how many steps all ways share."""
        lines = [trace(way) for way in self._ways]
        return sum(all(line[k] is lines[0][k] for line in lines) for k in range(1, len(lines[0])))

    def _settle(self, steps: int) -> list[Configuration]:
        """Moves the first steps of all ways, which they share, to the decided; forgets what came before."""
        if steps > 0:
            line = trace(self._ways[0])
            self._decided += [way.configuration for way in line[1 : steps + 1]]
            object.__setattr__(line[steps], "before", None)
        return self._decided


def trace(way: Way) -> list[Way]:
    """Returns a way's beginnings, the shortest first, and itself."""
    line = [way]
    while line[-1].before is not None:
        line.append(line[-1].before)
    return line[::-1]
