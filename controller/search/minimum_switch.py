"""Fewest switches: the cheapest configuration within the tolerance, and a proof that no cheaper one exists.

The arm is cut in two. Both halves' configurations near the previous one are listed, cheapest first, and meet in the
middle; what is found costs less than anything left out, or else the pairs left out are checked: one half of such a pair
costs more than was listed, so the other costs little, and for each of those few the dear half is cut in two again.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.found import CLOSE, Found
from controller.search.halves import Halves
from controller.search.nearest import Nearest
from controller.search.quarters import Quarters
from controller.search.reach import Reach
from controller.search.target import Target

Array = NDArray[np.float64]

NEAR = 1 << 14  # rows of a half, for a beginning
LADDER = (1 << 16, 1 << 18)  # the next where the one before proves nothing
BEAMS = (32, 128, 512)  # widths, the next where there is time
MOST_CHECKS = 128


class MinimumSwitch:
    """The search of one manipulator, with the memory for its tables."""

    def __init__(self, manipulator: Manipulator, reach: Reach) -> None:
        """Cuts the arm into halves and quarters of like numbers of configurations; allocates."""
        self._m = manipulator
        self._near, self._wide = Halves(manipulator, NEAR), Halves(manipulator, LADDER[-1])
        self._quarters = Quarters(manipulator, self._near.cut)
        self._nearest, self._reach = Nearest(manipulator, self._wide), reach
        self._row_time = 0.0

    def claim(self) -> None:
        """Has the system hand out memory now, not in the middle of a search with a deadline.

        Only searches that take long list more than the first rung of LADDER; they have the time to wait for memory.
        """
        self._near.claim()
        self._wide.claim(LADDER[0])
        self._quarters.claim()
        self._nearest.claim()

    def expect(self, centre: Configuration, costs: Array, tolerance: float) -> Iterator[None]:
        """Lists and sorts, step by step, what the search of a goal begins with; what is so already costs nothing."""
        self._near.list(centre, costs, costs)
        yield
        self._near.sort(tolerance * CLOSE)
        yield
        self._quarters.list(centre, costs)
        yield
        self._quarters.sort(tolerance * CLOSE)

    def improve(
        self,
        target: Target,
        centre: Configuration,
        costs: Array,
        first: Callable[[], Found],
        widen: Callable[[Found, int], Found],
        until: float,
        latest: float,
        hopeless: bool = False,
    ) -> Found:
        """Returns the cheapest configuration within the tolerances, and what is proven of its cost.

        Args:
            target: in frame F_0, with what to keep clear of.
            centre: the configuration that costs nothing, shape (B,).
            costs: of every state of every module, at least 0, shape (B, Kmax).
            first: gives an answer from far and wide, of infinite cost if it is not within the tolerance.
            widen: looks for a better one farther from the centre, with a beam of a width.
            until: `time.perf_counter()` at which to be done, nearly.
            latest: the same, where nothing is within the tolerances yet.
            hopeless: whether it is known that nothing is.
        """
        best, near = Found(centre, np.inf, np.inf), self._near
        if time.perf_counter() < until and not hopeless:
            near.list(centre, costs, costs)
            best = self._proven(near, target, centre, costs, best, until)
        if best.cost == np.inf and (hopeless or self._reach.excludes(target.position, target.tolerance)):
            best = replace(best, bound=np.inf)
        if best.bound < best.cost or best.cost == np.inf:
            best = replace(best.better(first()), bound=best.bound)
        if not best.settled:
            best = self._further(target, centre, costs, best, widen, until)
        if not best.settled and best.cost == np.inf and latest > until:
            best = self._further(target, centre, costs, best, widen, latest)
        return best if best.cost < np.inf else replace(self._nearest.improve(target, best, until), bound=best.bound)

    def reach(self, target: Target, best: Configuration, until: float) -> Configuration:
        """Returns a configuration within the tolerances near one that is not, or else the nearest found."""
        free = np.zeros(self._m.bits.shape[:2])
        found = self._nearest.improve(target, Found(best, np.inf, np.inf), until)
        for most in (NEAR, *LADDER):
            if found.cost == np.inf:
                found = self._wander(target, free, found, most, until)
        return found.configuration

    def _further(
        self,
        target: Target,
        centre: Configuration,
        costs: Array,
        best: Found,
        widen: Callable[[Found, int], Found],
        until: float,
    ) -> Found:
        """Returns what beams and longer lists find until the deadline, and prove."""
        began = time.perf_counter()
        if began > until:
            return best
        best = widen(best, BEAMS[0])
        beam_time = time.perf_counter() - began
        if best.cost == np.inf:  # what is nearer is nearer to what is within the tolerance, too
            best = self._nearest.improve(target, best, until)
        for most in (NEAR, *LADDER):
            best = self._wander(target, costs, best, most, until)
            if best.cost < np.inf or not target.hard:
                break
        best = self._proven(self._near, target, centre, costs, best, until)
        for most in LADDER:
            if best.settled or time.perf_counter() + most * self._row_time > until:
                break
            self._list(centre, costs, costs, most)
            best = self._proven(self._wide, target, centre, costs, best, until)
            if not best.settled:
                better = self._wander(target, costs, best, most, until - most * self._row_time)
                best = replace(better, bound=best.bound)
        for before, width in pairwise(BEAMS):
            beam_time *= 1.5 * width / before
            if best.settled or time.perf_counter() + beam_time > until:
                break
            better = self._wander(target, costs, widen(best, width), NEAR, until)
            best = replace(better, bound=best.bound)
        return best

    def _list(self, centre: Configuration, distances: Array, costs: Array, most: int) -> None:
        """Lists the wide halves, and notes how long a row takes, with room."""
        began = time.perf_counter()
        self._wide.list(centre, distances, costs, most)
        rows = len(self._wide.lower.costs) + len(self._wide.upper.costs)
        self._row_time = 4.0 * (time.perf_counter() - began) / rows

    def _wander(self, target: Target, costs: Array, best: Found, most: int, until: float) -> Found:
        """Returns the cheapest configuration that is near the best, again and again until it is the best itself."""
        while time.perf_counter() < until:
            own = self._m.bits[np.arange(len(best.configuration)), best.configuration]
            distances = (self._m.bits != own[:, None]).sum(axis=2).astype(float)
            self._list(best.configuration, distances, costs, most)
            better = self._wide.meet(target, best, until)
            if better.cost >= best.cost:
                return better
            best = better
        return best

    def _proven(
        self,
        halves: Halves,
        target: Target,
        centre: Configuration,
        costs: Array,
        best: Found,
        until: float,
    ) -> Found:
        """Returns the best of all pairs listed, and a bound on the cost of those left out, checked if they are few."""
        best = halves.meet(target, best, until)
        lower, upper = halves.lower, halves.upper
        bound = min(lower.beyond, upper.beyond, halves.unasked)
        if bound < best.cost and halves.unasked == np.inf:
            below = np.flatnonzero(lower.costs < best.cost - upper.beyond)
            above = np.flatnonzero(upper.costs < best.cost - lower.beyond)
            if len(below) + len(above) <= MOST_CHECKS:
                below, above = below[np.argsort(lower.costs[below])], above[np.argsort(upper.costs[above])]
                self._quarters.list(centre, costs)
                return self._quarters.check(target, halves, below, above, best, until)
        return Found(best.configuration, best.cost, best.square, bound)
