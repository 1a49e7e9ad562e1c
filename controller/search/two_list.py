"""Meet in the middle: both halves of the arm, each listed near a seed, are matched for one goal after another."""

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.cells import Cells, Index
from controller.search.frame_rows import Side, coordinates, fixed, invert_all, motions
from controller.search.matching import Found, Span, match
from controller.search.segment import Segment, Sets, build_segment, room
from controller.search.solution import Incumbent
from controller.search.target import Target

Array = NDArray[np.float64]

CANDIDATE_ROWS = 1 << 12  # of each half, for those who choose among many configurations
BAND_CELLS = 1 << 16  # of an index of few rows that many others are looked up in
AT_ONCE = 1 << 15  # lower rows matched between two looks at the clock


class TwoList:
    """Memory for the rows of both halves, used again for each seed.

    Attributes:
        cut: modules in the lower half.
        lower: rows of the modules below the cut; their frames lead back, F_0 in F_cut.
        upper: rows of those above; frames F_B in F_cut.
        bands: memory for an index of upper rows, and of lower ones, see four_list.

    Args:
        manipulator: the arm.
        most: rows of a half, at most.
    """

    lower: Segment
    upper: Segment

    def __init__(self, manipulator: Manipulator, most: int) -> None:
        self._states, self._motions = manipulator.states, motions(manipulator)
        count = len(self._states)
        self.cut = middle(manipulator, 0, count)
        self._ends = ((0, self.cut), (self.cut, count))
        self._rows = [room(rows(manipulator, *ends, most), self._motions.shape[1]) for ends in self._ends]
        size = coordinates(self._motions)
        self._cells = Cells(len(self._rows[1].costs), size)
        self.bands = tuple(Cells(len(half.costs), size, BAND_CELLS) for half in self._rows[::-1])
        self._key: tuple[NDArray[np.generic], ...] = ()
        self._sorted: tuple[float, ...] = ()
        self._index: Index

    def claim(self, most: int | None = None) -> None:
        """Has the system hand out the memory of so many rows, or of all, before a search with a deadline."""
        for half in self._rows:
            half.claim(most)
        for cells in (self._cells, *self.bands):
            cells.claim(most)
        self._key = self._sorted = ()

    def list(self, seed: Configuration, distances: Array, costs: Array, most: int | None = None) -> None:
        """Lists the configurations nearest to the seed; does nothing if they are listed already.

        Args:
            seed: shape (B,).
            distances: of each module's states from the seed's, shape (B, Kmax).
            costs: of each module's states, shape (B, Kmax).
            most: rows of a half, at most; absent: as many as there is room for.
        """
        key = (seed, distances, costs, np.array([0 if most is None else most]))
        if self._key and all(map(np.array_equal, key, self._key)):
            return
        self._key, self._sorted = (), ()  # until it is done
        self.lower, self.upper = (
            build_segment(Sets(self._motions, self._states, seed, distances, costs), half, *ends, most)
            for half, ends in zip(self._rows, self._ends, strict=True)
        )
        invert_all(self.lower.frames)
        self._key = tuple(np.array(part) for part in key)

    def index(self, radius: float, chord: float) -> Index:
        """Returns the index of the upper rows, see Cells.fill; the same as before if nothing has changed."""
        if self._sorted != (radius, chord):
            self._sorted = ()
            self._index = self._cells.fill(self.upper.side(), radius, chord)
            self._sorted = (radius, chord)
        return self._index

    def match(self, target: Target, incumbent: Incumbent) -> tuple[bool, float]:
        """Offers the cheapest pair to the incumbent.

        Returns whether there was time for all pairs, and the least cost of a configuration left out.

        The nearest pair is offered of those that cost the same.
        """
        index, lower, goal = self.index(target.radius, target.chord), self.lower.side(), fixed(target.row)
        beyond = min(self.lower.beyond, self.upper.beyond)
        for start in range(0, len(lower.costs), AT_ONCE):
            if start > 0 and incumbent.late:
                return False, min(beyond, float(lower.costs[start:].min()))
            span = Span(start, min(start + AT_ONCE, len(lower.costs)), 0, 1, -np.inf, np.inf)
            improve(incumbent, (lower, goal, index), span, target, self._key[0].astype(np.int64))
        return True, beyond


def improve(
    incumbent: Incumbent,
    sides: tuple[Side, Side, Index],
    span: Span,
    target: Target,
    seed: Configuration,
    *,
    nearer: bool = True,
) -> None:
    """Offers the cheapest match of a span to the incumbent.

    Args:
        incumbent: as good as what is looked for, or not as good.
        sides: outer, inner and index.
        span: of outer and inner.
        target: the goal.
        seed: that all sides continue, shape (B,).
        nearer: whether a match of equal cost that is nearer to the goal is better.
    """
    square = incumbent.square if nearer else -np.inf
    found = Found(np.full((1, 3), -1), np.array([incumbent.cost]), np.array([square]))
    match(*sides, span, target.query, seed, target.scene, found)
    if found.rows[0, 0] >= 0:
        outer, inner, index = sides
        configuration = seed.copy()
        for side, row in zip((outer, inner, index.side), found.rows[0].tolist(), strict=True):
            write(side, row, configuration)
        incumbent.offer(configuration, float(found.costs[0]), float(found.squares[0]))


def write(side: Side, n: int, configuration: Configuration) -> None:
    """Puts the states of a side's row `n` in a configuration (B,) that has the seed's."""
    row = int(side.rows[n])
    while row > 0:
        configuration[side.modules[row]] = side.choices[row]
        row = int(side.parents[row])


class Candidates:
    """The cheapest configurations near a given one, with the memory to find them.

    Args:
        manipulator: the arm.
        most: how many to find at most.
    """

    def __init__(self, manipulator: Manipulator, most: int) -> None:
        self._two, self._most = TwoList(manipulator, CANDIDATE_ROWS), most

    def find(self, target: Target, seed: Configuration, costs: Array) -> tuple[NDArray[np.int64], Array]:
        """Returns configurations (n, B) whose tips are within the tolerances and clear, and what they cost (n,).

        Args:
            target: in frame F_0.
            seed: the configuration that costs nothing, shape (B,).
            costs: of every state of every module, shape (B, Kmax).
        """
        two = self._two
        two.list(seed, costs, costs)
        lower, goal, index = two.lower.side(), fixed(target.row), two.index(target.radius, target.chord)
        room = self._most
        found = Found(np.full((room, 3), -1), np.full(room, np.inf), np.full(room, np.inf))
        span = Span(0, len(lower.costs), 0, 1, -np.inf, np.inf)
        match(lower, goal, index, span, target.query, seed, target.scene, found)
        chosen = np.flatnonzero(found.rows[:, 0] >= 0)
        configurations = np.tile(seed, (len(chosen), 1))
        for configuration, row in zip(configurations, found.rows[chosen].tolist(), strict=True):
            for side, n in zip((lower, goal, index.side), row, strict=True):
                write(side, n, configuration)
        return configurations, found.costs[chosen]


def middle(manipulator: Manipulator, first: int, last: int) -> int:
    """Returns the module at which modules first+1 to last are cut into like numbers of configurations."""
    sizes = np.concatenate([[0.0], np.cumsum(np.log2(manipulator.states[first:last]))])
    return first + int(np.argmin(np.abs(sizes - sizes[-1] / 2)))


def rows(manipulator: Manipulator, first: int, last: int, most: int) -> int:
    """Returns how many rows modules first+1 to last need: for `most` configurations, or for all if they are fewer."""
    return int(min(most, np.prod(manipulator.states[first:last].astype(float)))) + 1
