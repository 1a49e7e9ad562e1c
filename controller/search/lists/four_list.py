"""Four lists: finds the pairs that two lists leave out, or proves that they are no better.

One half of such a pair costs more than was listed. Its other half is cheap if the pair is better than the incumbent.
Each half is cut again into two quarters, which are listed completely or nearly so. The expensive half is streamed as
pairs of its quarters, in layers of rising cost (Schroeppel and Shamir 1981, "A T = O(2^(n/2)), S = O(2^(n/4)) algorithm
for certain NP-complete problems"). Each pair is looked up among the cheap rows of the other half. If the cheap rows are
few, each of them is looked up among the pairs instead.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.search.lists.cells import Cells, Index, filling
from hyperbit.controller.search.lists.matching import Sides, Span
from hyperbit.controller.search.lists.segment import (
    Segment,
    Sets,
    Side,
    build_segment,
    compose_all,
    coordinates,
    invert_all,
    motions,
    step,
)
from hyperbit.controller.search.lists.two_list import BAND_CELLS, ListSizes, TwoList, improve, middle, room_for
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.target import SearchTarget

Array = NDArray[np.float64]

BINS = 512  # bins of costs, for the sizes of layers
FEWER = 4  # rebuild an index if it has this many times more rows than needed
LOOKUP = 3  # time to look up a pair in a full index, relative to an index of few rows


class FourList:
    """The rows of all quarters, in memory that is reused for each seed.

    The lower half has `cut` modules.
    """

    # least cost of a configuration of the lower and of the upper half that the quarters do not list
    unexplored: tuple[float, float]
    unit: float  # width of a layer
    # approximate number of configurations of lower and upper half by cost in units, shape (2, BINS)
    layers: tuple[Array, Array]

    def __init__(self, manipulator: Manipulator, cut: int, sizes: ListSizes) -> None:
        self.sizes = sizes
        self._states, self._motions = manipulator.states, motions(manipulator)
        count, size = len(self._states), coordinates(self._motions)
        first, second = middle(manipulator, 0, cut), middle(manipulator, cut, count)
        self._ends = ((0, first), (first, cut), (cut, second), (second, count))
        self._rows = [room_for(manipulator, *ends, sizes.quarter) for ends in self._ends]
        self._above, self.below = (Cells(len(self._rows[k].costs), size) for k in (3, 0))
        self._key: tuple[bytes, ...] = ()  # what is listed
        self.a: Side  # first quarter, inverse frames
        self.b: tuple[Side, Side]  # frames, and inverse frames
        self.c: tuple[Side, Side]
        self.d: Side

    def claim(self) -> None:
        """Touches all memory, so that no search waits for page faults."""
        for quarter in self._rows:
            quarter.claim()
        self._above.claim()
        self.below.claim()
        self._key = ()

    def list(self, seed: Configuration, costs: Array) -> None:
        """Lists the cheapest configurations of the quarters; returns at once if they are listed already.

        The seed (B,) costs 0, the states of the modules `costs` (B, Kmax).
        """
        if self._key == (seed.tobytes(), costs.tobytes()):
            return
        self._key = ()  # until it is done
        parts = [
            build_segment(Sets(self._motions, self._states, seed, costs, costs), quarter, *ends)
            for quarter, ends in zip(self._rows, self._ends, strict=True)
        ]
        a, b, c, self.d = (part.side(rows=np.argsort(part.costs)) for part in parts)
        self.a, self.b, self.c = inverse(a), (b, inverse(b)), (c, inverse(c))
        own = [part.unexplored for part in parts]
        self.unexplored = min(own[0], own[1]), min(own[2], own[3])
        least = step(costs, self._states, 0, len(self._states))
        most = max(float(low.costs[-1] + high.costs[-1]) for low, high in ((a, b), (c, self.d)))
        self.unit = max(least if least < np.inf else 1.0, most / (BINS - 2), 1e-300)
        self.layers = self._sizes(a, b), self._sizes(c, self.d)
        self._key = (seed.tobytes(), costs.tobytes())

    @property
    def count(self) -> int:
        return sum(len(side.costs) for side in (self.a, self.b[0], self.c[0], self.d))

    def index(self, radius: float, chord: float) -> Index:
        """Returns the index of the uppermost quarter, see Cells.fill."""
        return self._above.fill(self.d, radius, chord)

    def _sizes(self, low: Side, high: Side) -> Array:
        first, second = (
            np.bincount((side.costs / self.unit + 1e-6).astype(np.int64), minlength=1).astype(float)
            for side in (low, high)
        )
        return np.convolve(first, second)


def inverse(side: Side) -> Side:
    """Returns a side with inverse frames."""
    frames = side.frames.copy()
    invert_all(frames)
    return side._replace(frames=frames)


def seen(frame: Array, side: Side) -> Side:
    """Returns a side with the products of its frames and a frame (4,) or (12,)."""
    frames = np.empty_like(side.frames)
    compose_all(side.frames, frame[None], frames)
    return side._replace(frames=frames)


@dataclass(eq=False)
class HalfStream:
    """The configurations of one half in layers of rising cost, against cheap rows of the other half (the band)."""

    upper: bool  # whether the upper half is streamed
    band: Side  # rows of the other half in the order of their costs, with the goal in their frames, or with their tips
    floor: float  # least cost of the band
    done: float  # cost up to which the half was streamed
    cells: Cells  # memory for the index of the band
    index: Index | None = None  # index of the band; None until it is needed

    @property
    def bound(self) -> float:
        """Least cost of a pair that the stream has not compared."""
        return self.done + self.floor


class FourListProof:
    """The streams for one goal and a seed (B,) of cost 0. The stream with the lowest bound continues first.

    Attributes:
        rest: least cost of a pair that is in no stream.
    """

    def __init__(self, four: FourList, target: SearchTarget, seed: Configuration) -> None:
        self._four, self._target, self._seed = four, target, seed
        self._inner: Side
        self._streams: list[HalfStream] = []
        self.rest = 0.0

    @property
    def begun(self) -> bool:
        return len(self._streams) > 0

    def add(self, two: TwoList, floors: tuple[float, float], starts: tuple[float, float], most: float) -> None:
        """Adds streams of both halves against the rows of two lists.

        Args:
            two: rows of both halves.
            floors: least cost of the lower and upper rows that earlier streams have not compared.
            starts: cost at which the streams of the lower and upper half start.
            most: cost of the incumbent; pairs must be cheaper.
        """
        lower, upper = two.lower, two.upper
        self._inner = seen(self._target.row, self._four.a)
        for of_upper, half, floor, start in ((False, upper, floors[1], starts[0]), (True, lower, floors[0], starts[1])):
            cells = two.bands[of_upper]
            self._streams.append(HalfStream(of_upper, self._band(half, floor, most - start), floor, start, cells))
        self.rest = lower.unexplored + upper.unexplored

    def run(self, incumbent: Incumbent) -> None:
        """Streams until there is a proof, the deadline passes, or the cheapest remaining pair is in no stream."""
        while True:
            stream = min(self._streams, key=lambda s: s.bound)
            incumbent.prove(min(stream.bound, self.rest))
            unexplored = self._four.unexplored[stream.upper]
            if incumbent.over or stream.bound >= self.rest or stream.done >= unexplored:
                return
            if not self._advance(stream, incumbent, unexplored):
                return

    def _band(self, half: Segment, floor: float, ceiling: float) -> Side:
        """Returns the rows of a half that cost from `floor` to less than `ceiling`, in the order of their costs."""
        chosen = np.flatnonzero((half.costs >= floor) & (half.costs < ceiling))
        chosen = chosen[np.argsort(half.costs[chosen])]
        side = half.side(rows=chosen)
        return seen(self._target.row, side) if half.first == 0 else side

    def _advance(self, stream: HalfStream, incumbent: Incumbent, unexplored: float) -> bool:
        """Streams one layer, or looks up the band. Returns whether it finished in time."""
        four, band, target = self._four, stream.band, self._target
        count = int(np.searchsorted(band.costs, incumbent.cost - stream.done))
        layers, first = four.layers[stream.upper], int(stream.done / four.unit + 1e-6)
        outer, inner = (four.c[0], four.d) if stream.upper else (four.b[1], self._inner)
        last, size = first + 1, float(layers[first : first + 1].sum())
        while last < len(layers) and size < four.sizes.layer:
            size += layers[last]
            last += 1
        if count * len(outer.costs) * LOOKUP <= size:
            return self._look_up(stream, count, incumbent, unexplored)
        if stream.index is None or FEWER * count < len(stream.index.side.costs):
            cheap = band._replace(frames=band.frames[:count], costs=band.costs[:count], rows=band.rows[:count])
            stream.index = stream.cells.fill(cheap, target.radius, target.chord, BAND_CELLS)
            incumbent.clock.charge(filling(stream.index))
        low, high = (
            stream.done - 1e-9 * four.unit,
            min(last * four.unit, unexplored) if last < len(layers) else unexplored,
        )
        at_once = max(int(len(outer.costs) * four.sizes.at_once / max(size, 1.0)), 1)
        for start in range(0, len(outer.costs), at_once):
            if incumbent.late:
                return False
            span = Span(start, min(start + at_once, len(outer.costs)), 0, len(inner.costs), low, high)
            improve(incumbent, Sides(outer, inner, stream.index), span, target, self._seed, nearer=False)
        stream.done = high
        return True

    def _look_up(self, stream: HalfStream, count: int, incumbent: Incumbent, unexplored: float) -> bool:
        """Looks up all rows of the band that a better pair may have. Returns whether it finished in time."""
        four, target, band, done = self._four, self._target, stream.band, stream.done
        if stream.upper:
            outer, index = four.c[1], four.index(target.radius, target.chord)
        else:
            outer, index = four.b[0], four.below.fill(self._inner, target.radius, target.chord)
        incumbent.clock.charge(filling(index))
        at_once = max(four.sizes.at_once // (LOOKUP * len(outer.costs)), 1)
        for start in range(0, count, at_once):
            if band.costs[start] + done >= incumbent.cost:
                break
            if incumbent.late:
                # A remaining pair has a row of the band from `start` on, or a half that the quarters do not list.
                stream.done = min(done + float(band.costs[start]) - stream.floor, unexplored)
                incumbent.prove(min(self.rest, *(s.bound for s in self._streams)))
                return False
            span = Span(0, len(outer.costs), start, min(start + at_once, count), -np.inf, np.inf)
            improve(incumbent, Sides(outer, band, index), span, target, self._seed, nearer=False)
        stream.done = unexplored
        return True
