"""Leaps: all configurations near the previous one, and near others from which the goal is within reach.

A list of all changes that cost little, see `listing`, finds or excludes every configuration near one. A long arm
reaches nearly everything by few switches. If the list around the previous configuration has nothing for the goal, a
longer one follows. Then single changes bring the tip near the goal, and short lists around those configurations follow.
"""

import numpy as np
from numba import int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F3, I2, UNCOUNTED
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.clock import CHANGED as CHANGED_ONE
from hyperbit.controller.search.clock import NEIGHBOUR
from hyperbit.controller.search.lists.two_list import ListSizes
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
from hyperbit.controller.search.solution import EPSILON, Incumbent
from hyperbit.controller.search.target import Problem

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LONG = 3  # switches of half a budget; lists that reach so far are of an arm that other searches prove sooner
MOST_ROWS, MOST_FOUND = 1 << 20, 1 << 16  # changes in memory; configurations of one list
WIDTHS = 4, 16  # configurations with equally many single changes around which lists are made
CACHED = 5e5  # changes beyond which each takes longer, in proportion, as the processor's caches are small
DEEP_SHARE = 0.5  # of the time that is left, for a deep list after a configuration was found


class Leaps:
    """Lists of the configurations of one arm that cost little from others.

    Attributes:
        worthwhile: whether the arm is so long that lists prove more than other searches in the same time.
    """

    def __init__(self, chain: Chain, by_switches: Chain, sizes: ListSizes = ListSizes()) -> None:
        """`by_switches` is the same arm with a cost of 1 for each switch."""
        self._near, self._deep = NearList(chain, sizes.near_changes), NearList(chain, sizes.deep_changes)
        equal = np.allclose(chain.costs, chain.least * by_switches.costs, rtol=EPSILON)
        self._deep_by_switches = None if equal else NearList(by_switches, sizes.deep_changes)
        near = NearList(by_switches, sizes.near_changes)
        self.worthwhile = not near.whole and near.budget < 2 * LONG

    def prove(self, problem: Problem, incumbent: Incumbent) -> None:
        """Offers the cheapest configuration near the seed, or proves that all cost more."""
        self._prove(self._near, problem, incumbent, incumbent.until)

    def prove_deep(self, problem: Problem, incumbent: Incumbent) -> None:
        """Does so by the longest lists for which there is room: by switches until something is found, then by cost."""
        far, share = self._deep_by_switches, 1.0
        if incumbent.cost == np.inf and far is not None:
            if far.offer(problem.seed, problem, far.budget, incumbent, incumbent.until):
                incumbent.prove(min(self._near.chain.least * (far.budget + far.unit), incumbent.cost))
            far.forget()
        if incumbent.cost < np.inf:
            share = DEEP_SHARE
        if not incumbent.over:
            self._prove(self._deep, problem, incumbent, incumbent.clock.now() + share * incumbent.remaining())
            self._deep.forget()

    def _prove(self, near: "NearList", problem: Problem, incumbent: Incumbent, until: float) -> None:
        budget = min(near.budget, incumbent.cost - near.unit)
        known = incumbent.bound >= budget + near.unit
        if not known and near.offer(problem.seed, problem, budget, incumbent, until):
            incumbent.prove(min(budget + near.unit, incumbent.cost))

    def improve(self, problem: Problem, incumbent: Incumbent, until: float) -> None:
        """Offers configurations near those that single changes of the seed lead to, until a time."""
        near = self._near
        for width in WIDTHS:
            level = problem.seed[None]
            while len(level := self._nearer(level, problem, incumbent.cost, width)):
                incumbent.clock.charge(CHANGED_ONE * level.size)
                for row in level:
                    budget = min(near.budget, incumbent.cost - problem.cost(row) - near.chain.least)
                    if incumbent.over or not near.offer(row, problem, budget, incumbent, until):
                        return

    def _nearer(self, level: Integers, problem: Problem, most: float, width: int) -> Integers:
        """Returns `width` of the configurations (n, B) a single change away, those whose tips are nearest to the goal.

        With one more switch they cost less than `most`.
        """
        costs, chain, changed = problem.costs, self._near.chain, self._near.lists(problem).changed
        modules, keys = np.arange(len(costs)), keys_of(chain, level)
        tips, squares = np.empty((*costs.shape, 3)), np.full((len(level), *costs.shape), np.inf)
        for n, row in enumerate(level):
            write_tips(chain, changed, keys, n, tips)
            added = costs - costs[modules, row][:, None]
            cheap = (added > 0) & (problem.cost(row) + added < most - 1.5 * chain.least)
            squares[n][cheap] = ((tips - problem.target.position) ** 2).sum(axis=2)[cheap]
        nearest = np.argsort(squares, axis=None)[: width * len(level)]
        nearest = nearest[squares.ravel()[nearest] < np.inf]
        rows, changed_modules, states = np.unravel_index(nearest, squares.shape)
        following: Integers = level[rows]
        following[np.arange(len(rows)), changed_modules] = states
        first = np.sort(np.unique(following, axis=0, return_index=True)[1])[:width]
        return following[first]


class NearList:
    """All configurations within a budget of one.

    At most `most` changes may cost half the budget. About as many are in memory, with up to 180 bytes each.

    Attributes:
        budget: the greatest.
        unit: least difference of two costs; 0 if that is unknown.
        whole: whether all configurations are within the budget.
    """

    def __init__(self, chain: Chain, most: int) -> None:
        self.chain, self._counts, half = chain, Counts(chain, len(chain.states)), chain.least
        within = self._counts.within
        while within(half) < within(half + chain.least) <= most:
            half += chain.least
        self.budget, self.unit = 2 * half, chain.least if chain.whole else 0.0
        self.whole = within(half) >= self._counts.all
        self._lists: Neighbours | None = None

    def offer(self, row: Configuration, problem: Problem, budget: float, incumbent: Incumbent, until: float) -> bool:
        """Offers the cheapest configuration within a budget of one (B,); False if there is no time or room for all."""
        changes = (self._counts.within(budget / 2) + self._counts.within((budget + self.unit) / 2)) / 2
        price = NEIGHBOUR * changes * max(changes / CACHED, 1.0)
        if incumbent.clock.now() + price > until:
            return False
        incumbent.clock.charge(price)
        keys, budgets = keys_of(self.chain, row), np.array([budget])
        found = self.lists(problem).near(0, keys, budgets, MOST_FOUND, lambda: incumbent.late)
        if found is None:
            return False
        states = states_of(self.chain, found.keys)
        costs = problem.costs[np.arange(len(row)), states].sum(axis=1)
        if len(costs):
            n = int(np.argmin(costs))
            square = problem.target.square(problem.target.manipulator.tip(states[n]))
            incumbent.offer(states[n], float(costs[n]), square)
        return True

    def lists(self, problem: Problem) -> Neighbours:
        """Returns the memory of lists, for a goal."""
        target = problem.target
        places = places_of(self.chain, [(target, None)])
        if self._lists is None:
            rows = 4 * int(self._counts.within(self.budget / 2))
            self._lists = Neighbours(self.chain, places, target.scene, MOST_ROWS, rows)
        self._lists.places, self._lists.scene = places, target.scene
        return self._lists

    def forget(self) -> None:
        """Gives the memory back."""
        self._lists = None


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
