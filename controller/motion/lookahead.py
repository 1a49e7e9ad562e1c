"""Looking ahead: the sequence of configurations along a trajectory that switches least in all.

Many configurations are kept for each waypoint, each with its cheapest way there, and the cheapest of the ways to the
next waypoint are kept in turn. Ways that lead on soon have their beginning in common: that much is decided.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.manipulator.manipulator import Configuration
from controller.search.solver import Solver

WIDTH = 64  # ways kept
MOST = 32  # configurations looked at from each way
SPREAD = 1.0  # how much dearer than a way's cheapest continuation another may be, in least weights


@dataclass(frozen=True, eq=False)
class Way:
    """A sequence of configurations up to one waypoint.

    Attributes:
        cost: weighted switches from the first configuration on.
        configuration: at its end, shape (B,).
        before: the way to the waypoint before; None at the first.
    """

    cost: float
    configuration: Configuration
    before: Way | None


class LookAhead:
    """Ways along a trajectory, extended waypoint by waypoint.

    Args:
        solver: of the arm.
        start: configuration that all ways begin with, shape (B,).
        tolerance: of the tip's distance from each waypoint.
    """

    def __init__(self, solver: Solver, start: Configuration, tolerance: float) -> None:
        self._solver, self._tolerance = solver, tolerance
        self._ways = [Way(0.0, np.array(start, dtype=np.int64), None)]
        self._decided: list[Configuration] = []  # after `start`

    def extend(self, goal: ArrayLike) -> None:
        """Leads all ways on to the next waypoint, a position in the world."""
        best: dict[bytes, Way] = {}
        for way in self._ways:
            for configuration, cost in self._onward(way, goal):
                key, total = configuration.tobytes(), way.cost + cost
                if key not in best or best[key].cost > total:
                    best[key] = Way(total, configuration, way)
        if not best:  # too far for the small tables: one way on, by the search that goes farther
            way = self._ways[0]
            found = self._solver.solve(goal, way.configuration, self._tolerance)
            best[b""] = Way(way.cost + found.cost, found.configuration, way)
        self._ways = sorted(best.values(), key=lambda way: way.cost)[:WIDTH]

    def _onward(self, way: Way, goal: ArrayLike) -> list[tuple[NDArray[np.int64], float]]:
        configurations, costs = self._solver.candidates(goal, way.configuration, self._tolerance, MOST)
        if len(costs) == 0:
            return []
        near = costs <= costs.min() + SPREAD * self._solver.least_weight
        return list(zip(configurations[near], costs[near].tolist(), strict=True))

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
