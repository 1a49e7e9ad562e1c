"""Detours: clear switches of single actuators from a configuration to any of several, by RRT-Connect and by flooding.

The graph has a configuration for each vertex, and a clear switch of one actuator for each edge. Each clear stage can be
cut into clear switches, one after the other, so that this graph connects all that clear stages connect.

RRT-Connect (Kuffner and LaValle 2000) grows a tree from the start and one from the ends, each towards random
configurations and then towards the other. Among these are bent ones, which lead around obstacles. Most ways are found
at once. Flooding visits all that can be reached from the start, and all from which an end can be reached, in turn. If
one of both ends, it proves that there is no way. A shorter proof is a graph of the lowest modules alone: if they cannot
pass, the whole arm cannot.

Sweep alone decides whether a switch is clear. The kernels find most clear and most colliding switches faster. Sweep
checks the others before a flood ends.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.stages.state_trees import (
    StateTree,
    find,
    packed,
    plant,
    root_of,
    route,
    state_tree,
    unpacked,
)
from hyperbit.controller.motion.stages.walks import ROOM, extend, flood, grow, next_undecided, step, walk_of
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.distance import Index
from hyperbit.controller.obstacles.sweep import Sweep
from hyperbit.controller.search.clock import WALL, Clock

Late = Callable[[], bool]  # returns whether the time of a search is over; what it raises ends the planning

CHECKS = 400  # switches to check between two looks at the time: about 10 ms
SWEEPS = 0.01  # [s] of swept checks between two looks at the time
GROWN, FLOODED = 1 << 17, 1 << 19  # most configurations of a tree
LOWEST, HIGHER = 8, 2  # least actuators of the lowest modules in a proof, and of the modules from one proof to the next
DIRECT, TRIES = 32, 3  # ends to which walks are tried first, and their number
SHORTCUTS = 60  # tries to shorten a way


class Detour(NamedTuple):
    """A way to one of the ends: the actuators that switch, one after the other (n,), and the end (B,)."""

    order: Index
    end: Configuration


class NoWay(NamedTuple):
    """A proof that there is no way."""

    proof: str  # in words
    reached: Index | None = None  # all configurations that can be reached, shape (n, B), if the proof has listed them


class Meeting(NamedTuple):
    """The number of a configuration in a tree from the start, and in one from the ends."""

    first: StateTree
    number: int
    second: StateTree
    met: int


class Graph:
    """The graph of the lowest modules of an arm, with trees from the start and from the ends.

    If `both`, it is flooded from the ends, too. For the other arguments see Detours.

    Attributes:
        start: the tree of the flood from the start.
    """

    def __init__(
        self,
        clearance: BodyClearance,
        start: Configuration,
        ends: Index,
        modules: int,
        *,
        once: bool = False,
        both: bool = True,
        clock: Clock = WALL,
    ) -> None:
        self._clock = clock
        self._clearance, self._roots, self._modules, self._both = clearance, (start[None], ends), modules, both
        self._flooding, self._growing = walk_of(clearance, modules, once), walk_of(clearance, modules)
        self.start, self._ends = (self._tree(roots, FLOODED) for roots in self._roots)
        self._flooding.target[:] = self._ends.bits[0]

    def grown(self, seed: int) -> Iterator[Meeting | NoWay | None]:
        """Yields None until RRT-Connect has found a way; begins again with new trees if there is no more room."""
        self._growing.random[0] = seed
        while True:
            (first, second), rounds = (self._tree(roots, GROWN) for roots in self._roots), 0
            while max(first.counts[0], second.counts[0]) + ROOM < len(first.parents):
                number, met, rounds = grow(self._growing, first, second, rounds, CHECKS)
                yield None if number < 0 else Meeting(first, number, second, met)

    def flooded(self) -> Iterator[Meeting | NoWay | None]:
        """Yields None until flooding has found a way or a proof; it never ends."""
        start, ends = self.start, self._ends
        both = ((start, ends), (ends, start)) if self._both else ((start, ends),)
        while all(tree.counts[1:].min() < tree.counts[0] for tree, _ in both):
            for tree, other in both:
                number, met = flood(self._flooding, tree, other, CHECKS // len(both))
                if number < 0 and tree.counts[1] == tree.counts[0]:
                    number, met = self._decide(tree, other)
                if number >= 0:
                    yield Meeting(start, number, ends, met) if tree is start else Meeting(start, met, ends, number)
            yield None
        proof = NoWay("no other place can be reached from there")
        if start.counts[1:].min() == start.counts[0]:
            count = int(start.counts[0])
            proof = NoWay(f"{count} configurations can be reached", start.configurations[:count].astype(np.int64))
        while True:  # a search with another result may go on
            yield proof

    @cached_property
    def _sweep(self) -> Sweep:
        return Sweep(self._clearance, self._modules)

    def _decide(self, tree: StateTree, other: StateTree) -> tuple[int, int]:
        """Checks undecided switches of a flooded tree, up to one that is clear, and adds its neighbour.

        Returns the configurations of both trees where they meet, -1 if they do not.
        """
        walk, until = self._flooding, self._clock.now() + SWEEPS
        while self._clock.now() < until and (actuator := next_undecided(walk, tree)) >= 0:
            number = int(tree.counts[2])
            states = unpacked(tree.bits[number], len(walk.order))
            if self._sweep.first_collision(states, np.array([actuator])) is None:
                added = step(walk, tree, number, actuator, True)
                met = find(other, tree.bits[added])
                return (added, met) if met >= 0 else (-1, -1)
        return -1, -1

    def _tree(self, roots: Index, capacity: int) -> StateTree:
        tree = state_tree(self._clearance.manipulator, self._modules, capacity + len(roots))
        plant(tree, self._clearance.manipulator, roots)
        return tree


def lowest(clearance: BodyClearance, start: Configuration, ends: Index) -> Iterator[NoWay | None]:
    """Yields None until a graph of the lowest modules has a proof; for ever if there is none."""
    counts = np.cumsum([len(module.actuators) for module in clearance.manipulator.modules])
    last = LOWEST - HIGHER
    for modules in range(1, len(counts)):
        if counts[modules - 1] < last + HIGHER:
            continue
        last, met = counts[modules - 1], False
        graph = Graph(clearance, start, ends, modules)
        searches = [graph.grown(1), graph.flooded()]
        while not met:
            results = list(map(next, searches))
            met = any(isinstance(result, Meeting) for result in results)
            proven = any(isinstance(result, NoWay) for result in results)
            yield NoWay(f"its modules 1 to {modules} cannot pass") if proven and not met else None
    while True:
        yield None


class Detours:
    """Ways from one configuration to any of several.

    Args:
        clearance: bodies and obstacles of the arm.
        start: a clear configuration, shape (B,).
        ends: clear configurations, the best first, shape (n, B), n >= 1.
        complete: there are no other ends, so that it is a proof if none of them can be reached.
        once: no actuator may switch twice; only with one end.
        threads: that search at the same time.
        clock: limits the checks between two looks at the time.
    """

    def __init__(
        self,
        clearance: BodyClearance,
        start: Configuration,
        ends: Index,
        *,
        complete: bool = True,
        once: bool = False,
        threads: int = 1,
        clock: Clock = WALL,
    ) -> None:
        self._clearance, self._arm, self._start, self._ends = clearance, clearance.manipulator, start, ends
        self._once, self._threads, self._seed = once, threads, 0
        self._walk = walk_of(clearance, len(start))
        self._whole = Graph(clearance, start, ends, len(start), once=once, both=complete and not once, clock=clock)
        self._proofs = [self._whole.flooded()]
        if complete and not once:
            self._proofs.append(lowest(clearance, start, ends))

    def search(self, late: Late) -> Detour | NoWay | None:
        """Returns a way or a proof; None if there is neither in time. Further calls may find other ways.

        `late` is called between parts of the search, from this thread.
        """
        self._seed += 1
        searches: list[Iterator[Detour | Meeting | NoWay | None]] = [*self._proofs]
        if not self._once:
            searches.insert(0, chain(self._direct(), self._whole.grown(self._seed)))
        with ThreadPoolExecutor(min(self._threads, len(searches))) as pool:
            advance = map if self._threads == 1 else pool.map
            while not late():
                for result in list(advance(next, searches)):
                    if result is not None:
                        return self._way(result) if isinstance(result, Meeting) else result
        return None

    def order_to(self, configuration: Configuration) -> Index:
        """Returns the way to a configuration (B,) that NoWay has listed."""
        tree, bits = self._whole.start, packed(self._arm.actuator_states(configuration)[None])[0]
        return np.array(route(tree, find(tree, bits))[::-1], dtype=np.int64)

    def _direct(self) -> Iterator[Detour | None]:
        """Yields None until a walk to one of the first ends is found on which no actuator switches twice."""
        self._walk.random[0] = self._seed
        for end in self._ends[:DIRECT]:
            order = self._straight(self._start, end, TRIES)
            yield None if order is None else Detour(order, end)

    def _straight(self, first: Configuration, last: Configuration, tries: int = 1) -> Index | None:
        """Returns a way on which no actuator switches twice, by random walks; None if none is found."""
        self._walk.target[:] = packed(self._arm.actuator_states(last)[None])[0]
        tree = state_tree(self._arm, len(first), tries * len(self._walk.order) + 1)
        plant(tree, self._arm, first[None])
        for _ in range(tries):
            number, _ = extend(self._walk, tree, 0)
            if (tree.bits[number] == self._walk.target).all():
                return np.array(route(tree, number)[::-1], dtype=np.int64)
        return None

    def _way(self, meeting: Meeting) -> Detour:
        """Returns the way over a configuration where two trees meet, shortened."""
        first, number, second, met = meeting
        end = second.configurations[root_of(second, met)].astype(np.int64)
        order = np.array(route(first, number)[::-1] + route(second, met), dtype=np.int64)
        return Detour(order if self._once else self._shortened(order), end)

    def _shortened(self, order: Index) -> Index:
        """Returns a shorter way: parts of it are replaced by walks on which no actuator switches twice."""
        start, rng = self._arm.actuator_states(self._start), np.random.default_rng(self._seed)
        for k in range(SHORTCUTS):
            rows = np.cumsum(np.vstack([start, np.eye(len(start), dtype=np.int64)[order]]), axis=0) % 2
            first, last = (0, len(order)) if k == 0 else np.sort(rng.integers(0, len(rows), 2)).tolist()
            if last - first > np.count_nonzero(rows[first] != rows[last]):
                ends = self._arm.configuration(rows[first]), self._arm.configuration(rows[last])
                if (straight := self._straight(*ends)) is not None:
                    order = np.concatenate([order[:first], straight, order[last:]])
        return order
