"""Complete candidate sets: all configurations within the tolerances of a goal that cost little from given sources."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import int64, njit, types
from numpy.typing import NDArray

from hyperbit.controller.manipulator.kernel_types import F1
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.plans.halves import (
    CANDIDATES,
    CHANGES,
    PLACE,
    STATES,
    CandidateList,
    CellMemory,
    Changes,
    Place,
    States,
    index_half,
    match,
)
from hyperbit.controller.obstacles.scene import Scene, for_scenes
from hyperbit.controller.search.method import costs_between_states
from hyperbit.controller.search.segment import ROWS, Rows, Sets, grow, motions, rank, room
from hyperbit.controller.search.target import SearchTarget
from hyperbit.controller.search.two_list import middle

Array = NDArray[np.float64]

FEWEST_ROWS, MOST_ROWS = 1 << 10, 1 << 18  # least and greatest memory of a half: changes within half a budget
ROUNDING = 1e-9  # relative rounding error of sums of weights
AT_ONCE = 32  # sources between two checks of the deadline

HALVES: Any = types.UniTuple(ROWS, 2)  # type: ignore[no-untyped-call]
COUNTS: Any = types.UniTuple(int64, 2)  # type: ignore[no-untyped-call]


@njit(
    for_scenes(lambda scene: COUNTS(CHANGES, PLACE, scene, STATES, F1, HALVES, CANDIDATES)),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def list_candidates(
    changes: Changes,
    place: Place,
    scene: Scene | None,
    sources: States,
    budgets: Array,
    halves: tuple[Rows, Rows],
    listed: CandidateList,
) -> tuple[int, int]:
    """Lists the clear configurations within the tolerances that cost at most a budget from each source.

    Returns the number of sources that are done; and what has no room: rows (1), configurations (2), or nothing (0).

    The arm is cut in two (meet in the middle). The changes of one half that cost at most half the budget are put into
    cells by their matching points: the tip in frame F_cut for the upper half, the goal in frame F_cut for the lower.
    All changes of the other half are looked up in these cells; then the halves swap roles.

    Args:
        changes: the arm.
        place: the goal.
        scene: obstacles.
        sources: configurations, shape (n, B).
        budgets: greatest cost from each source, shape (n,).
        halves: memory for changes of the lower half, and of the same size for those of the upper half.
        listed: written.
    """
    modules, most_rows, prices = sources.shape[1], len(halves[0].costs), changes.costs
    memory = CellMemory(np.zeros((most_rows, 4)), np.empty((most_rows, 4), np.int32), np.empty(4 * most_rows, np.int32))
    near, seed = np.zeros(prices.shape[:2]), np.empty(modules, np.int64)
    for n in range(len(sources)):
        begun, budget = listed.written[0], budgets[n] * (1 + ROUNDING)
        for i in range(modules):
            seed[i] = sources[n, i]
            for j in range(prices.shape[1]):
                near[i, j] = prices[i, seed[i], j]
        sets = Sets(changes.motions, changes.states, seed, near, near)
        below, above = rank(sets, 0, changes.cut), rank(sets, changes.cut, modules)
        for lower in (False, True):
            rows, own, start = (halves[0], below, 0) if lower else (halves[1], above, changes.cut)
            other, first = (above, changes.cut) if lower else (below, 0)
            known, _ = grow(sets, own, start, budget / 2, most_rows, rows)
            lacks = 1 if known == most_rows else 0
            if lacks == 0:
                half = index_half(lower, rows, known, place, memory)
                lacks = 0 if match(sets, other, first, budget, place, scene, half, listed) else 2
            if lacks > 0:
                listed.written[0] = begun
                return n, lacks
        listed.sources[begun : listed.written[0]] = n
    return len(sources), 0


class CandidateSets:
    """Lists complete candidate sets of one arm, by weights of switches (B, Amax); holds the memory for them."""

    def __init__(self, manipulator: Manipulator, weights: Array) -> None:
        cut = max(middle(manipulator, 0, len(manipulator.modules)), 1)
        moves = motions(manipulator)
        self._changes = Changes(moves, manipulator.states, costs_between_states(manipulator, weights), cut)
        self._halves = room(FEWEST_ROWS, moves.shape[1]), room(FEWEST_ROWS, moves.shape[1])

    def find(
        self,
        target: SearchTarget,
        sources: States,
        budgets: Array,
        most: int,
        late: Callable[[], bool],
    ) -> CandidateList | None:
        """Returns all clear configurations within the tolerances that cost at most a budget (n,) from a source (n, B).

        Returns None if they are more than `most`, if `late()` becomes true, or if a half has too many changes.
        """
        listed = CandidateList(
            np.empty(most, np.int64), np.empty((most, sources.shape[1]), np.uint16), np.zeros(1, np.int64)
        )
        place, first = Place(target.query, target.position), 0
        while first < len(sources):
            part, count = slice(first, first + AT_ONCE), int(listed.written[0])
            done, lacks = list_candidates(
                self._changes, place, target.scene, sources[part], budgets[part], self._halves, listed
            )
            listed.sources[count : listed.written[0]] += first
            first += done
            if lacks == 2 or (lacks == 1 and len(self._halves[0].costs) >= MOST_ROWS) or late():
                return None
            if lacks == 1:
                rows, width = self._halves[0].frames.shape
                self._halves = room(4 * rows, width), room(4 * rows, width)
        count = int(listed.written[0])
        return CandidateList(listed.sources[:count], listed.configurations[:count], listed.written)
