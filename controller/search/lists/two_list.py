"""Two lists (meet in the middle): both halves of the arm are listed near a seed and matched for each goal."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.search.clock import COMPARED
from hyperbit.controller.search.lists.cells import Cells, Index, filling
from hyperbit.controller.search.lists.matching import Matches, Sides, Span, match, put
from hyperbit.controller.search.lists.segment import (
    Rows,
    Segment,
    Sets,
    build_segment,
    coordinates,
    fixed,
    invert_all,
    motions,
    room,
)
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.target import SearchTarget

Array = NDArray[np.float64]

BAND_CELLS = 1 << 16  # cells of an index of few rows, in which many others are looked up


class ListSizes(NamedTuple):
    """Sizes of all lists. Short lists leave more to proofs: tests take those that a small arm exceeds.

    Attributes:
        near: rows of a half in the near lists.
        wide: rows of a half to extend a proof, if the incumbent costs little more than the near lists.
        widest: rows of a half in the longest lists around the incumbent.
        quarter: most rows of a quarter.
        layer: fewest pairs of a layer of quarters, unless it is the last.
        at_once: pairs of quarters between two checks of the deadline.
        matched: lower rows matched between two checks of the deadline.
        near_changes: changes of half the cost of a list of neighbours, of which a search makes many, see Leaps.
        deep_changes: those of the one long list of neighbours.
    """

    near: int = 1 << 14
    wide: int = 1 << 16
    widest: int = 1 << 18
    quarter: int = 1 << 14
    layer: int = 1 << 14
    at_once: int = 1 << 17
    matched: int = 1 << 15
    near_changes: int = 1 << 18
    deep_changes: int = 5 << 18

    @property
    def ladder(self) -> tuple[int, int, int]:
        """Rows of a half in lists around the incumbent."""
        return self.near, self.wide, self.widest


class TwoList:
    """At most `most` rows of each half, in memory that is reused for each seed.

    Attributes:
        cut: number of modules in the lower half.
        bands: memory for an index of upper rows, and of lower rows, see four_list.
    """

    lower: Segment  # rows of the modules below the cut, with inverse frames: F_0 in F_cut
    upper: Segment  # rows of the modules above the cut, with frames F_B in F_cut

    def __init__(self, manipulator: Manipulator, most: int, matched: int = ListSizes().matched) -> None:
        self._states, self._motions, self._matched = manipulator.states, motions(manipulator), matched
        count = len(self._states)
        self.cut = middle(manipulator, 0, count)
        self._ends = ((0, self.cut), (self.cut, count))
        self._rows = [room_for(manipulator, *ends, most) for ends in self._ends]
        size = coordinates(self._motions)
        self._cells = Cells(len(self._rows[1].costs), size)
        self.bands = tuple(Cells(len(half.costs), size, BAND_CELLS) for half in self._rows[::-1])
        self._key: tuple[bytes | int | None, ...] = ()  # what is listed
        self._seed = np.empty(0, dtype=np.int64)

    def claim(self, most: int | None = None) -> None:
        """Touches the memory of `most` rows, or of all, so that no search waits for page faults."""
        for half in self._rows:
            half.claim(most)
        for cells in (self._cells, *self.bands):
            cells.claim(most)
        self._key = ()

    def list(self, seed: Configuration, distances: Array, costs: Array, most: int | None = None) -> None:
        """Lists the configurations nearest to the seed (B,); returns at once if they are listed already.

        Args:
            seed: the nearest itself.
            distances: distance of each module's states from the seed's state, shape (B, Kmax).
            costs: cost of each module's states, shape (B, Kmax).
            most: greatest number of rows of a half; None: as many as fit.
        """
        key = (seed.tobytes(), distances.tobytes(), costs.tobytes(), most)
        if key == self._key:
            return
        self._key = ()  # until it is done
        self.lower, self.upper = (
            build_segment(Sets(self._motions, self._states, seed, distances, costs), half, *ends, most)
            for half, ends in zip(self._rows, self._ends, strict=True)
        )
        invert_all(self.lower.frames)
        self._key, self._seed = key, np.array(seed, dtype=np.int64)

    def index(self, radius: float, chord: float) -> Index:
        """Returns the index of the upper rows, see Cells.fill."""
        return self._cells.fill(self.upper.side(), radius, chord)

    @property
    def count(self) -> int:
        return len(self.lower.costs) + len(self.upper.costs)

    def match(self, target: SearchTarget, incumbent: Incumbent) -> tuple[bool, float]:
        """Offers the cheapest pair to the incumbent; ties are broken by distance.

        Returns whether all pairs were compared before the deadline, and the least cost of an unexplored configuration.
        """
        index, lower, goal = self.index(target.radius, target.chord), self.lower.side(), fixed(target.row)
        incumbent.clock.charge(filling(index))
        unexplored = min(self.lower.unexplored, self.upper.unexplored)
        for start in range(0, len(lower.costs), self._matched):
            if start > 0 and incumbent.late:
                return False, min(unexplored, float(lower.costs[start:].min()))
            span = Span(start, min(start + self._matched, len(lower.costs)), 0, 1, -np.inf, np.inf)
            improve(incumbent, Sides(lower, goal, index), span, target, self._seed)
        return True, unexplored

    def cheapest(self, target: SearchTarget, most: int) -> tuple[NDArray[np.int64], Array, bool]:
        """Returns at most `most` of the cheapest clear configurations (n, B) within the tolerances among the rows.

        Returns their costs (n,), too, and whether there are no others.
        """
        sides = Sides(self.lower.side(), fixed(target.row), self.index(target.radius, target.chord))
        matches = Matches(np.full((most, 3), -1), np.full(most, np.inf), np.full(most, np.inf))
        span = Span(0, len(sides.outer.costs), 0, 1, -np.inf, np.inf)
        match(sides, span, target.query, self._seed, target.scene, matches)
        chosen = np.flatnonzero(matches.rows[:, 0] >= 0)
        configurations = np.tile(self._seed, (len(chosen), 1))
        for configuration, found in zip(configurations, matches.rows[chosen].tolist(), strict=True):
            put_match(configuration, self._seed, sides, found)
        listed = self.lower.unexplored == self.upper.unexplored == np.inf
        return configurations, matches.costs[chosen], listed and len(chosen) < most


def improve(
    incumbent: Incumbent,
    sides: Sides,
    span: Span,
    target: SearchTarget,
    seed: Configuration,
    *,
    nearer: bool = True,
) -> None:
    """Offers the cheapest match of a span to the incumbent, if it is better; `seed` (B,) is that of all sides.

    If `nearer`, ties of the cost are broken by distance.
    """
    square = incumbent.square if nearer else -np.inf
    matches = Matches(np.full((1, 3), -1), np.array([incumbent.cost]), np.array([square]))
    incumbent.clock.charge(COMPARED * match(sides, span, target.query, seed, target.scene, matches))
    if matches.rows[0, 0] >= 0:
        configuration = seed.copy()
        put_match(configuration, seed, sides, matches.rows[0].tolist())
        incumbent.offer(configuration, float(matches.costs[0]), float(matches.squares[0]))


def put_match(states: Configuration, seed: Configuration, sides: Sides, rows: Sequence[int]) -> None:
    """Writes the states of a match to `states` (B,), from its rows (3,) in outer, inner and lookup."""
    for side, row in zip((sides.outer, sides.inner, sides.lookup.side), rows, strict=True):
        put(states, seed, side, row)


def middle(manipulator: Manipulator, first: int, last: int) -> int:
    """Returns the cut of modules first+1 to last into two parts with nearly equal numbers of configurations."""
    sizes = np.concatenate([[0.0], np.cumsum(np.log2(manipulator.states[first:last]))])
    return first + int(np.argmin(np.abs(sizes - sizes[-1] / 2)))


def room_for(manipulator: Manipulator, first: int, last: int, most: int) -> Rows:
    """Returns memory for `most` configurations of modules first+1 to last, or for all if they are fewer."""
    count = int(min(most, np.prod(manipulator.states[first:last].astype(float)))) + 1
    return room(count, 4 if manipulator.planar else 12)
