"""Leaps: all configurations near the previous one, and near others from which the goal is within reach.

A list of all changes that cost little, see `listing`, finds or excludes every configuration near one. A long arm
reaches nearly everything by few switches. If the list around the previous configuration has nothing for the goal,
single changes bring the tip near the goal, and lists around those configurations follow.
"""

import numpy as np
from numba import int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F3, I2, UNCOUNTED
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.clock import CHANGED as CHANGED_ONE
from hyperbit.controller.search.clock import NEIGHBOUR
from hyperbit.controller.search.neighbours.chain import (
    CHAIN,
    Chain,
    keys_of,
    moved,
    moved_back,
    places_of,
    state_of,
    states_of,
)
from hyperbit.controller.search.neighbours.changes import CHANGED, Changed, prepare
from hyperbit.controller.search.neighbours.counts import Counts
from hyperbit.controller.search.neighbours.neighbours import Neighbours
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.target import Problem

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_HALF = 1 << 18  # changes that cost at most half a budget
LONG = 3  # switches of half a budget; lists that reach so far are of an arm that other searches prove sooner
MOST_ROWS, MOST_FOUND = 1 << 20, 1 << 16  # changes in memory; configurations of one list
WIDTHS = 4, 16  # configurations with equally many single changes around which lists are made


class Leaps:
    """Lists of the configurations of one arm that cost little from others.

    Attributes:
        worthwhile: whether the arm is so long that lists prove more than other searches in the same time.
    """

    def __init__(self, chain: Chain) -> None:
        self._chain, self._counts, half = chain, Counts(chain, len(chain.states)), chain.least
        within = self._counts.within
        while within(half) < within(half + chain.least) <= MOST_HALF:
            half += chain.least
        cheapest = np.where(chain.costs > 0, chain.costs, np.inf).min(axis=(1, 2))  # of each module
        self._budget, self.worthwhile = 2 * half, within(half) < self._counts.all and half < LONG * np.median(cheapest)
        self._lists: Neighbours | None = None

    def prove(self, problem: Problem, incumbent: Incumbent) -> None:
        """Offers the cheapest configuration near the seed, or proves that all cost more."""
        unit = self._chain.least if self._chain.whole else 0.0
        budget = min(self._budget, incumbent.cost - unit)
        known = incumbent.bound >= budget + unit
        if not known and self._list(problem.seed, problem, budget, incumbent, incumbent.until):
            incumbent.prove(min(budget + unit, incumbent.cost))

    def improve(self, problem: Problem, incumbent: Incumbent, until: float) -> None:
        """Offers configurations near those that single changes of the seed lead to, until a time."""
        for width in WIDTHS:
            level = problem.seed[None]
            while len(level := self._nearer(level, problem, incumbent.cost, width)):
                incumbent.clock.charge(CHANGED_ONE * level.size)
                for row in level:
                    budget = min(self._budget, incumbent.cost - problem.cost(row) - self._chain.least)
                    if incumbent.over or not self._list(row, problem, budget, incumbent, until):
                        return

    def _list(self, row: Configuration, problem: Problem, budget: float, incumbent: Incumbent, until: float) -> bool:
        """Offers the cheapest configuration within a budget of one (B,); False if there is no time or room for all."""
        chain, price = self._chain, NEIGHBOUR * self._counts.within(budget / 2)
        if incumbent.clock.now() + price > until:
            return False
        incumbent.clock.charge(price)
        lists = self._memory(problem)
        found = lists.near(0, keys_of(chain, row), np.array([budget]), MOST_FOUND, lambda: incumbent.late)
        if found is None:
            return False
        states = states_of(chain, found.keys)
        costs = problem.costs[np.arange(len(row)), states].sum(axis=1)
        if len(costs):
            n = int(np.argmin(costs))
            square = problem.target.square(problem.target.manipulator.tip(states[n]))
            incumbent.offer(states[n], float(costs[n]), square)
        return True

    def _memory(self, problem: Problem) -> Neighbours:
        """Returns the lists, for a goal."""
        target = problem.target
        places = places_of(self._chain, [(target, None)])
        if self._lists is None:
            rows = 4 * int(self._counts.within(self._budget / 2))
            self._lists = Neighbours(self._chain, places, target.scene, MOST_ROWS, rows)
        self._lists.places, self._lists.scene = places, target.scene
        return self._lists

    def _nearer(self, level: Integers, problem: Problem, most: float, width: int) -> Integers:
        """Returns `width` of the configurations (n, B) a single change away, those whose tips are nearest to the goal.

        With one more switch they cost less than `most`.
        """
        costs, changed = problem.costs, self._memory(problem).changed
        modules, keys = np.arange(len(costs)), keys_of(self._chain, level)
        tips, squares = np.empty((*costs.shape, 3)), np.full((len(level), *costs.shape), np.inf)
        for n, row in enumerate(level):
            write_tips(self._chain, changed, keys, n, tips)
            added = costs - costs[modules, row][:, None]
            cheap = (added > 0) & (problem.cost(row) + added < most - 1.5 * self._chain.least)
            squares[n][cheap] = ((tips - problem.target.position) ** 2).sum(axis=2)[cheap]
        nearest = np.argsort(squares, axis=None)[: width * len(level)]
        nearest = nearest[squares.ravel()[nearest] < np.inf]
        rows, changed_modules, states = np.unravel_index(nearest, squares.shape)
        following: Integers = level[rows]
        following[np.arange(len(rows)), changed_modules] = states
        first = np.sort(np.unique(following, axis=0, return_index=True)[1])[:width]
        return following[first]


@kernel(types.void(CHAIN, CHANGED, I2, int64, F3), **UNCOUNTED)
def write_tips(chain: Chain, changed: Changed, keys: Integers, n: int, tips: Array) -> None:
    """Writes the tips (B, Kmax, 3) of keys[n] with one module in another state; infinite for its own state."""
    prepare(chain, changed, keys, n)
    frames, (modules, kinds) = changed.frames, chain.costs.shape[:2]
    tip_z = 0.0 if frames.shape[1] == 4 else frames[modules, 2]
    tips[:] = np.inf
    for i in range(modules):
        x, y, z = moved_back(frames, i + 1, frames[modules, 0], frames[modules, 1], tip_z)
        for j in range(chain.states[i]):
            if j != state_of(chain, keys, n, i):
                u, v, w = moved(chain.motions, i * kinds + j, x, y, z)
                tips[i, j, 0], tips[i, j, 1], tips[i, j, 2] = moved(frames, i, u, v, w)
