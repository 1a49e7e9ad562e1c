"""Fewest switches: the cheapest configuration within the tolerance, and a proof that no cheaper one exists.

The arm is cut in two. Both halves' configurations near the previous one are listed, cheapest first, and meet in the
middle; what is found costs less than anything left out, or else the pairs left out are checked: one half of such a pair
costs more than was listed, so the other costs little, and for each of those few the dear half is cut in two again.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.cells import Cells
from controller.search.meeting import carried, seen
from controller.search.segment import Segment, Storage, build_segment

Array = NDArray[np.float64]

LADDER = (1 << 14, 1 << 16, 1 << 18)  # rows of a half, the next where the one before proves nothing
QUARTER = 1 << 14
BEAMS = (32, 128, 512)  # widths, the next where there is time
MOST_CHECKS = 128
CLOSE = 1.0 - 1e-9  # the tolerance is kept whatever the order of additions


@dataclass(frozen=True, eq=False)
class Found:
    """The best configuration so far.

    Attributes:
        configuration: shape (B,).
        cost: of its switches; infinite while none is within the tolerance.
        square: squared distance of its tip from the goal.
        bound: no configuration within the tolerance costs less.
    """

    configuration: Configuration
    cost: float
    square: float
    bound: float = 0.0


Check = tuple[float, int, bool]


class MinimumSwitch:
    """The search of one manipulator, with the memory for its tables."""

    def __init__(self, manipulator: Manipulator) -> None:
        """Cuts the arm into halves and quarters of like numbers of configurations; allocates."""
        self._m = manipulator
        count = len(manipulator.modules)
        self._half = middle(manipulator, 0, count)
        first, second = middle(manipulator, 0, self._half), middle(manipulator, self._half, count)
        self._ends = ((0, first), (first, self._half), (self._half, second), (second, count))
        self._halves = [(self._store(0, self._half, most), self._store(self._half, count, most)) for most in LADDER]
        self._quarters = [self._store(*end, QUARTER) for end in self._ends]
        self._cells, self._lower_cells, self._upper_cells = (Cells(most + 1) for most in (LADDER[-1], QUARTER, QUARTER))
        self._asking = np.empty((max(storages[0].rows for storages in self._halves), 3))

    def claim(self) -> None:
        """Has the system hand out all memory now, not in the middle of a search with a deadline."""
        for storage in (*self._quarters, *(storage for pair in self._halves for storage in pair)):
            storage.claim()
        self._asking.fill(0)

    def improve(
        self,
        goal: Array,
        centre: Configuration,
        costs: Array,
        tolerance: float,
        best: Found,
        widen: Callable[[Found, int], Found],
        until: float,
    ) -> Found:
        """Returns the cheapest configuration within the tolerance, and what is proven of its cost.

        Args:
            goal: in frame F_0, shape (3,).
            centre: the configuration that costs nothing, shape (B,).
            costs: of every state of every module, at least 0, shape (B, Kmax).
            tolerance: of the tip's distance from the goal.
            best: a first answer, of infinite cost if it is not within the tolerance.
            widen: looks for a better one farther from the centre, with a beam of a width.
            until: `time.perf_counter()` at which to be done, nearly.
        """
        tolerance *= CLOSE
        bound, row_time, beam_time = 0.0, 0.0, 0.0
        for most, storages in zip(LADDER, self._halves, strict=True):
            began = time.perf_counter()
            if began + most * row_time > until:
                break
            lower, upper = self._list(storages, centre, costs, costs)
            best = self._meet(goal, lower, upper, centre, tolerance, best)
            rows = len(lower.costs) + len(upper.costs)
            # Larger tables miss the caches more: what the next takes is reckoned with room.
            row_time = 3.0 * (time.perf_counter() - began) / rows
            bound, checks = self._left_out(lower, upper, best)
            if checks:
                best, bound = self._check(goal, lower, upper, centre, costs, tolerance, best, checks, until)
            if bound >= best.cost or bound == np.inf:
                break
            if most == LADDER[0]:
                began = time.perf_counter()
                best = widen(best, BEAMS[0])
                beam_time = time.perf_counter() - began
            best = self._wander(goal, costs, tolerance, best, storages, until - most * row_time)
        for before, width in pairwise(BEAMS):
            beam_time *= 1.5 * width / before
            if bound >= best.cost or bound == np.inf or time.perf_counter() + beam_time > until:
                break
            best = self._wander(goal, costs, tolerance, widen(best, width), self._halves[0], until)
        return Found(best.configuration, best.cost, best.square, min(bound, best.cost))

    def _wander(
        self,
        goal: Array,
        costs: Array,
        tolerance: float,
        best: Found,
        storages: tuple[Storage, Storage],
        until: float,
    ) -> Found:
        """Returns the cheapest configuration that is near the best, again and again until it is the best itself."""
        while time.perf_counter() < until:
            own = self._m.bits[np.arange(len(best.configuration)), best.configuration]
            distances = (self._m.bits != own[:, None]).sum(axis=2).astype(float)
            lower, upper = self._list(storages, best.configuration, distances, costs)
            better = self._meet(goal, lower, upper, best.configuration, tolerance, best)
            if better.cost >= best.cost:
                return better
            best = better
        return best

    def _store(self, first: int, last: int, most: int) -> Storage:
        """Returns room for `most` configurations of modules first+1 to last, or for all if they are fewer."""
        return Storage(int(min(most, np.prod(self._m.states[first:last].astype(float)))) + 1)

    def _list(
        self, storages: tuple[Storage, Storage], centre: Configuration, distances: Array, costs: Array
    ) -> tuple[Segment, Segment]:
        count = len(self._m.modules)
        return (
            build_segment(self._m, storages[0], centre, distances, costs, 0, self._half),
            build_segment(self._m, storages[1], centre, distances, costs, self._half, count),
        )

    def _meet(
        self, goal: Array, lower: Segment, upper: Segment, centre: Configuration, tolerance: float, best: Found
    ) -> Found:
        self._cells.fill(upper.positions, upper.costs, tolerance)
        asking = self._asking[: len(lower.costs)]
        seen(goal, lower.rotations, lower.positions, asking)
        i, j, cost, square = self._cells.match(asking, lower.costs, best.cost, best.square)
        if i < 0:
            return best
        configuration = centre.copy()
        lower.write(i, configuration)
        upper.write(j, configuration)
        return Found(configuration, cost, square)

    def _left_out(self, lower: Segment, upper: Segment, best: Found) -> tuple[float, list[Check] | None]:
        """Returns a bound on the cost of all pairs not listed, and the rows to check; None if they are too many.

        A check is (cost, row, whether of the upper half): that row with every configuration of the other half.
        """
        bound = min(lower.beyond, upper.beyond)
        if bound >= best.cost:
            return bound, []
        above = np.flatnonzero(upper.costs + lower.beyond < best.cost)
        below = np.flatnonzero(lower.costs + upper.beyond < best.cost)
        if len(above) + len(below) > MOST_CHECKS:
            return bound, None
        checks = [(float(upper.costs[j]), int(j), True) for j in above]
        checks += [(float(lower.costs[i]), int(i), False) for i in below]
        return bound, sorted(checks)

    def _check(
        self,
        goal: Array,
        lower: Segment,
        upper: Segment,
        centre: Configuration,
        costs: Array,
        tolerance: float,
        best: Found,
        checks: list[Check],
        until: float,
    ) -> tuple[Found, float]:
        """Returns the best after the checks, and the bound on all pairs not listed that they prove."""
        a, b, c, d = (
            build_segment(self._m, storage, centre, costs, costs, *end)
            for storage, end in zip(self._quarters, self._ends, strict=True)
        )
        points = np.empty_like(a.positions)
        seen(goal, a.rotations, a.positions, points)
        self._lower_cells.fill(points, a.costs, tolerance)
        self._upper_cells.fill(d.positions, d.costs, tolerance)
        bound = lower.beyond + upper.beyond
        for cost, row, of_upper in checks:
            other = lower if of_upper else upper
            if cost + other.beyond >= best.cost:
                continue
            if time.perf_counter() > until:
                bound = min(bound, cost + other.beyond)
                break
            configuration = centre.copy()
            if of_upper:
                asking = self._asking[: len(b.costs)]
                carried(upper.positions[row], b.rotations, b.positions, asking)
                i, j, found, square = self._lower_cells.match(asking, b.costs + cost, best.cost, best.square)
                parts = ((b, i), (a, j), (upper, row))
                gap = min(a.beyond, b.beyond)
            else:
                r, p = lower.rotations[row], lower.positions[row]
                asking = self._asking[: len(c.costs)]
                seen(r.T @ (goal - p), c.rotations, c.positions, asking)
                i, j, found, square = self._upper_cells.match(asking, c.costs + cost, best.cost, best.square)
                parts = ((c, i), (d, j), (lower, row))
                gap = min(c.beyond, d.beyond)
            bound = min(bound, gap + cost)
            if i >= 0:
                for segment, part in parts:
                    segment.write(part, configuration)
                best = Found(configuration, found, square)
        return best, bound


def middle(manipulator: Manipulator, first: int, last: int) -> int:
    """Returns the module at which modules first+1 to last are cut into like numbers of configurations."""
    sizes = np.concatenate([[0.0], np.cumsum(np.log2(manipulator.states[first:last]))])
    return first + int(np.argmin(np.abs(sizes - sizes[-1] / 2)))
