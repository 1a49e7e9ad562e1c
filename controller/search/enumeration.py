"""All configurations of an arm that has few: each answer is then optimal, and a goal that is missed is out of reach."""

import numpy as np
from numba import boolean, float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, I1, I2
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.scene import Scene, collides, for_scenes
from hyperbit.controller.search.clock import LISTED
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.target import QUERY, Problem, SearchQuery, SearchTarget, squared_error, within

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

FOUND = types.Tuple((int64, float64, float64))  # type: ignore[no-untyped-call]


class Enumeration:
    """All configurations of an arm, in the order of `np.ndindex`.

    Attributes:
        configurations: shape (n, B).
        changes: number of changes of one module from each of them, those to the same state included.
    """

    def __init__(self, manipulator: Manipulator) -> None:
        self._states = manipulator.states
        self.configurations = np.indices(tuple(self._states)).reshape(len(self._states), -1).T.copy()
        self.changes = len(self.configurations) * int(self._states.sum())
        self._tips = manipulator.tips(self.configurations)

    def improve(self, problem: Problem, incumbent: Incumbent) -> None:
        """Offers the cheapest clear configuration within the tolerances, or the nearest one, with its proof."""
        target = problem.target
        incumbent.clock.charge(LISTED * len(self._tips))
        n, cost, square = best(target.query, target.scene, self.configurations, self._tips, problem.costs)
        if n >= 0:
            incumbent.offer(self.configurations[n], cost, square)
        incumbent.prove(cost)

    def index(self, configuration: Configuration) -> int:
        """Returns the row of a configuration (B,)."""
        return int(np.ravel_multi_index(tuple(configuration), tuple(self._states)))

    def met(self, target: SearchTarget) -> Flags:
        """Returns which configurations (n,) are within the tolerances of a target."""
        return np.asarray(all_within(target.query, self._tips))

    def spread(self, costs: Array, values: Array) -> None:
        """Sets the value (n,) of each configuration to the least of: value of another, plus the cost from there.

        `costs` of switches between states of a module have shape (B, Kmax, Kmax).
        """
        spread(costs, self._states, values)


@kernel(for_scenes(lambda scene: FOUND(QUERY, scene, I2, F3, F2)))
def best(
    query: SearchQuery, scene: Scene | None, configurations: Integers, tips: Frame, costs: Array
) -> tuple[int, float, float]:
    """Returns row, cost and squared error of the cheapest of all configurations (n, B) that are clear.

    Those outside the tolerances have infinite cost; among equal costs the nearest is taken. The row is -1 if none is
    clear.
    """
    found, least, nearest = -1, np.inf, np.inf
    for n in range(len(configurations)):
        cost = np.inf
        if within(tips[n], query.goal, query.tolerance, query.angle_tolerance):
            cost = 0.0
            for i in range(configurations.shape[1]):
                cost += costs[i, configurations[n, i]]
        if cost <= least:
            square = squared_error(tips[n], query.goal, query.weight)
            if (cost < least or square < nearest) and (scene is None or not collides(scene, configurations[n])):
                found, least, nearest = n, cost, square
    return found, least, nearest


@kernel(boolean[::1](QUERY, F3))
def all_within(query: SearchQuery, tips: Frame) -> Flags:
    """Returns which tips (n, 4, 4) are within the tolerances of a query."""
    result = np.empty(len(tips), np.bool_)
    for n in range(len(tips)):
        result[n] = within(tips[n], query.goal, query.tolerance, query.angle_tolerance)
    return result


@kernel(types.void(F3, I1, F1))
def spread(costs: Array, states: Integers, values: Array) -> None:
    """Sets each value to the least of all values (n,) plus costs, see `Enumeration.spread`.

    Costs are sums over the modules, so one module after the other may change its state.
    """
    row, inner = np.empty(costs.shape[1]), 1
    for i in range(len(states) - 1, -1, -1):
        kinds = states[i]
        for block in range(0, len(values), kinds * inner):
            for first in range(block, block + inner):
                for s in range(kinds):
                    row[s] = values[first + s * inner]
                for s in range(kinds):
                    least = row[s]
                    for r in range(kinds):
                        least = min(least, row[r] + costs[i, r, s])
                    values[first + s * inner] = least
        inner *= kinds
