"""One step of the labels from behind: from the configurations that serve a point to those that leave the one before."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.motion.plans.labels import cheapest, judged
from hyperbit.controller.search.neighbours.chain import states_of
from hyperbit.controller.search.neighbours.neighbours import Late, Neighbours, Pairs, joined
from hyperbit.controller.search.neighbours.pairs import Pairing
from hyperbit.controller.search.neighbours.serving import Walk, serving, walks
from hyperbit.controller.search.solution import EPSILON

if TYPE_CHECKING:
    from hyperbit.controller.motion.plans.cost_to_go import CostToGo

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SHARE = 1 << 14  # configurations that a thread takes at once
LABELS_OF_POINT = 1 << 21  # labels of one point, at most
MOST_FOUND = 1 << 22  # labels found from SHARE configurations
SHALLOWEST, DEEPEST_STEP = -8, 12  # least and greatest rise of a threshold in one step, in least weights
LEAF, COMPARED = 40e-9, 15e-9  # [s] of a configuration of the lower modules; of one that serves a point
SLACK_OF_WORK = 4.0  # a step that takes so many times as long as expected is given up


class Step:
    """The step from the configurations that serve point k + 1 to labels of those with exit k."""

    def __init__(self, to_go: CostToGo, k: int, near: Array, incumbent: float, late: Late) -> None:
        self._to_go, self._k, self._near, self._incumbent, self._late = to_go, k, near, incumbent, late
        self.spent = 0.0  # [s], see counts
        labels, self._far = to_go.labels, int(to_go.labels.last[k + 1])
        self._base = float(labels.thresholds[k + 1 : self._far + 1].min())
        self._values = labels.values[labels.of(k + 1)]
        least = float(to_go.least[k + 1 : self._far + 1].min())
        self._limit = (incumbent - to_go.unit - least) * (1 + EPSILON)  # greatest cost from the start
        self._fixed = bool(to_go.places.fixed[k + 1])
        self._joins = bool(to_go.joins[k] and to_go.joins[k + 1])
        self._pairing: Pairing | None = None

    def depth(self, limit: float, deepest: int) -> int | None:
        """Returns how many least weights the threshold rises over the least of the next ones within a time [s]."""
        for depth in range(deepest, SHALLOWEST - 1, -1):
            if self._expected(depth) <= limit:
                return depth
        return None

    def _target(self, depth: int) -> float:
        return self._base + depth * self._to_go.chain.least

    def _most(self, depth: int) -> float:
        """Returns the most that a label to be found may have."""
        return self._target(depth) - self._to_go.unit

    def _budget(self, depth: int) -> float:
        """Returns the greatest budget of a configuration without a label."""
        return self._most(depth) - self._base

    def _expected(self, depth: int) -> float:
        to_go = self._to_go
        time = float(self._prices(self._most(depth) - self._values, depth).sum())
        if self._enumerates(depth):
            thresholds = to_go.labels.thresholds[self._k + 1 : self._far + 1]
            shares = to_go.shares(self._k + 1)
            listing, count = to_go.expected(self._k + 1, self._limit)
            time += listing + count * float((shares * self._prices(self._most(depth) - thresholds, depth)).sum())
        return time

    def _prices(self, budgets: Array, depth: int) -> Array:
        """Returns the times [s] to find labels near configurations, by their budgets (...)."""
        to_go, near = self._to_go, self._to_go.counts.prices(budgets, self._to_go.share(self._k))
        if not (self._joins and self._enumerates(depth)):
            return near
        apart = budgets > self._budget(depth) * (1 + EPSILON)
        return np.where(apart, near, np.minimum(near, to_go.half.joins(budgets, to_go.chain.least)))

    def _enumerates(self, depth: int) -> bool:
        """Returns whether configurations without labels must be listed."""
        return self._fixed or self._budget(depth) >= self._to_go.chain.least * (1 - EPSILON)

    def run(self, depth: int) -> bool:
        """Sets the labels and the threshold of point k; returns False if there is no time or room for this depth."""
        to_go, labels = self._to_go, self._to_go.labels
        self._allowed = self.spent + SLACK_OF_WORK * self._expected(depth) + 1.0
        parts: SimpleQueue[Walk | Integers] = SimpleQueue()
        for part in self._parts(depth):
            parts.put(part)
        results = list[tuple[Integers, Array] | None]()

        def work(neighbours: Neighbours) -> None:
            with suppress(Empty):
                while self._allowed >= self.spent:
                    for keys in self._keys(parts.get_nowait()):
                        results.append(found := self._found(neighbours, keys, depth))
                        if found is None:
                            self._allowed = -np.inf  # the other threads end, too
                            return

        if len(to_go.neighbours) == 1:
            work(to_go.neighbours[0])
        else:
            with ThreadPoolExecutor(len(to_go.neighbours)) as pool:
                try:
                    list(pool.map(work, to_go.neighbours))
                except BaseException:
                    self._allowed = -np.inf  # the other threads end, too
                    raise
        listed = [found for found in results if found is not None]
        if len(listed) < len(results) or self.spent > self._allowed:
            return False
        keys = np.concatenate([np.empty((0, 1), np.int64), *(keys for keys, _ in listed)])
        values = np.concatenate([np.empty(0), *(values for _, values in listed)])
        chosen = cheapest(keys, values)
        keys, values, threshold = keys[chosen, 0], values[chosen], self._target(depth)
        most = min(LABELS_OF_POINT, len(labels.keys) - to_go.used)
        if len(keys) > most:
            threshold = float(np.partition(values, most)[most])
            keys, values = keys[values < threshold], values[values < threshold]
        begin = to_go.used
        to_go.used = end = begin + len(keys)
        labels.keys[begin:end], labels.values[begin:end] = keys, values
        labels.begins[self._k], labels.ends[self._k], labels.thresholds[self._k] = begin, end, threshold
        to_go.least[self._k] = min(threshold, float(values.min(initial=np.inf)))
        return True

    def _parts(self, depth: int) -> Iterable[Walk | Integers]:
        """Returns what the threads share: walks through the configurations that serve point k + 1, or their keys."""
        k, to_go, labels = self._k + 1, self._to_go, self._to_go.labels
        if self._fixed:
            return [to_go.places.given[k : k + 1]]
        if self._enumerates(depth):
            assert to_go.tips is not None
            self.spent += to_go.expected(k, self._limit)[0]
            if (own := self._pair(depth)) is not None:
                return np.array_split(own[:, None], max(len(own) // SHARE, 1))
            return walks(to_go.chain, to_go.tips, self._near)
        own = labels.keys[labels.of(k)][self._most(depth) - self._values >= to_go.chain.least * (1 - EPSILON)]
        return np.array_split(own[:, None], max(len(own) // SHARE, 1))

    def _pair(self, depth: int) -> Integers | None:
        """Prepares the pairs of two lists, if that is cheaper; returns the keys (n,) that serve point k + 1."""
        self._pairing, budget, to_go = None, np.array(self._budget(depth)), self._to_go
        if not self._joins or self._prices(budget, depth) == to_go.counts.prices(budget, to_go.share(self._k)):
            return None
        lists = [to_go.all_serving(k, self._incumbent, self._late) for k in (self._k, self._k + 1)]
        if lists[0] is None or lists[1] is None:
            return None
        self._pairing = Pairing(to_go.chain, lists[0], float(budget))
        return lists[1]

    def _keys(self, part: Walk | Integers) -> Iterator[Integers]:
        """Yields the keys (n, 1) of a part."""
        if not isinstance(part, Walk):
            yield part
            return
        to_go, k = self._to_go, self._k + 1
        assert to_go.tips is not None
        where = to_go.places.positions[k], float(to_go.places.radii[k])
        for found in serving(to_go.chain, to_go.tips, part, self._near, self._limit, *where):
            yield found[:, None]

    def _found(self, neighbours: Neighbours, keys: Integers, depth: int) -> tuple[Integers, Array] | None:
        """Returns keys and values of labels of point k that are near keys (n, 1) which serve point k + 1."""
        to_go, k = self._to_go, self._k
        rest, _ = judged(neighbours, to_go.labels, k + 1, keys)
        budgets = self._most(depth) - rest
        use = np.flatnonzero(budgets >= (0.0 if self._fixed else to_go.chain.least * (1 - EPSILON)))
        self.spent += float(self._prices(budgets[np.isfinite(budgets)], depth).sum())
        if self.spent > self._allowed:
            return None
        parts, pairing = list[Pairs](), self._pairing
        if pairing is not None:
            within = budgets[use] <= self._budget(depth) * (1 + EPSILON)
            some, use = use[within], use[~within]
            sources, others, costs = pairing.near(keys[some, 0], budgets[some] + to_go.chain.least * 1e-6)
            parts.append(Pairs(some[sources], others[:, None], costs))
        listed = neighbours.near(k, keys[use], budgets[use], MOST_FOUND, self._late)
        if listed is None:
            return None
        found = joined([*parts, listed._replace(sources=use[listed.sources])])
        near, values = found.keys, rest[found.sources] + found.costs
        if to_go.labels.last[k] > k or pairing is not None:
            _, exits = judged(neighbours, to_go.labels, k, near)
            keep = exits == k
            near, values = near[keep], values[keep]
        states = states_of(to_go.chain, near)
        from_start = self._near[np.arange(states.shape[1]), states].sum(axis=1)
        keep = (from_start + values < self._incumbent * (1 - EPSILON)) & (values < self._target(depth) * (1 - EPSILON))
        near, values = near[keep], values[keep]
        chosen = cheapest(near, values)
        return near[chosen], values[chosen]
