"""Fewest switches over a whole trajectory: label setting from the start, guided by labels from the end.

A layer holds configurations that serve one point, each with the cost of the cheapest known sequence that ends in it.
The next layer holds all configurations within the tolerances of the next point, up to a cost of the whole trajectory,
by the lower bound of the cost to go. A configuration stays as long as it serves. Narrow layers are a beam search, which
gives a plan. Complete layers contain every configuration that a sequence within the cost can pass. They give the
optimum, or prove that each sequence costs more.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.cheapest_sequence import cheapest_of_all
from hyperbit.controller.motion.plans.cost_to_go import CostToGo
from hyperbit.controller.motion.plans.labels import Layer, cheapest, near_labels
from hyperbit.controller.motion.plans.points import TrajectoryPoint
from hyperbit.controller.search.neighbours.chain import keys_of, states_of
from hyperbit.controller.search.neighbours.neighbours import Neighbours, Pairs, joined
from hyperbit.controller.search.search_time import SearchTime
from hyperbit.controller.search.solution import EPSILON, proves
from hyperbit.controller.search.solver import Solver

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

WIDTHS = tuple(4**n for n in range(1, 11))  # of layers, one after the other while there is time
GROWTH = 5.0  # expected factor of the time from one width, or one ceiling of a proof, to the next
WIDER = 12  # most steps of one least weight by which the ceiling rises to fill a layer
FIRST = SearchTime(0.01, unfound=0.5)  # to find one configuration that serves a point
MOST = 1 << 21  # configurations of a complete layer
# Shares of the time: narrow layers, a proof, labels, narrow layers with labels; a proof with labels follows.
BEAM, PROOF, SWEEP, GUIDED = 0.1, 0.2, 0.4, 0.15
BEAM_ALONE = 0.6  # share of narrow layers if the time is too short for labels
LEAST_SWEEP = 5.0  # [s] for labels; less is not worth the while
SCANNED = 10e-9  # [s] to compare a configuration with a label
DEEPER = 4  # most steps of one least weight by which neighbours are listed farther, so that fewer labels are compared
PRICE_OF_PLACE = 400e-6  # [s] to list neighbours for one place in a narrow layer
PRICE_OF_ONE = 5e-3  # [s] to list the neighbours of a configuration of a narrow layer, at most
ENOUGH = 4  # neighbours that are listed for each place in a narrow layer
PRICE_OF_LARGE, MOST_LARGE = 0.05, 256  # [s] from which on all that serves a point is tried; for so many configurations
FEW_KEYS = 256  # that one thread lists


class BestSequence(NamedTuple):
    """The cheapest sequence found of configurations that serve all points of a trajectory."""

    configurations: Integers | None  # shape (n, B); None if no sequence was found
    cost: float  # weighted switches; infinite if no sequence was found
    bound: float  # proven lower bound of the cost of any sequence


class LabelSetting:
    """The search for fewest switches over the points of one trajectory, or some of them in a row.

    It begins in the configuration `start` (B,), and ends early if `stop` returns true. `memory` is the greatest number
    of labels, of 16 bytes each; half as many tips of the upper modules are listed, of 20 bytes each.

    Attributes:
        best: the cheapest sequence found and the proven lower bound.
    """

    def __init__(
        self,
        solver: Solver,
        points: Sequence[TrajectoryPoint],
        start: Configuration,
        stop: Callable[[], bool] = lambda: False,
        threads: int = 1,
        memory: int = 1 << 22,
    ) -> None:
        self._points, self._stop, self._solver, self._until = points, stop, solver, np.inf
        self.to_go = CostToGo(solver, points, threads, memory, memory >> 1)
        self._start = keys_of(self.to_go.chain, start)
        self._most = memory >> 1  # configurations of all layers together
        self._most_listed = self.to_go.counts.affordable(PRICE_OF_LARGE)
        self._most_budget = self.to_go.counts.affordable(PRICE_OF_ONE)
        self.best = BestSequence(None, np.inf, 0.0)
        self._raise(self.first_bound())

    @property
    def optimal(self) -> bool:
        return proves(self.best.bound, self.best.cost)

    def offer(self, configurations: Integers, cost: float, first: float = 0.0) -> None:
        """Takes a sequence (n, B) if it is cheaper than the best; `first` is a lower bound of the first step's cost."""
        if cost < self.best.cost * (1 - EPSILON):
            self.best = self.best._replace(configurations=configurations, cost=cost)
        self._raise(first + float(self.to_go.least[: self.to_go.labels.last[0] + 1].min()))

    def _raise(self, bound: float) -> None:
        """Raises the bound. Labels leave out what costs more than the best sequence, and so prove no more."""
        self.best = self.best._replace(bound=max(self.best.bound, min(bound, self.best.cost)))

    def run(self, seconds: float) -> BestSequence:
        """Searches for a time [s]; returns the best sequence and its bound."""
        began, sweep = self._solver.clock.now(), SWEEP * seconds >= LEAST_SWEEP
        if self.try_all(seconds):
            return self.best
        with suppress(MemoryError):  # what is proven stays
            self._widen(began + (BEAM if sweep else BEAM_ALONE) * seconds)
            if not self.optimal and seconds > 0:
                self.to_go.list_tips(seconds)
            if sweep and not self.optimal:
                self._until = began + (BEAM + PROOF) * seconds
                self.prove()
                self._until = began + (BEAM + PROOF + SWEEP) * seconds
                if not self.optimal:
                    left = self._until - self._solver.clock.now()
                    self.to_go.sweep(self._start, self.best.cost, left, self._late)
                self._widen(began + (BEAM + PROOF + SWEEP + GUIDED) * seconds)
            self._until = began + seconds
            self.prove()
        return self.best

    def try_all(self, seconds: float) -> bool:
        """Tries all sequences if the arm has so few that a time [s] suffices; returns whether it did."""
        start = states_of(self.to_go.chain, self._start)[0]
        found = cheapest_of_all(self._solver, self._points, start, seconds, self._stop)
        if found is not None:
            self.offer(*found)
            self._raise(found[1])
        return found is not None

    def _widen(self, until: float) -> None:
        """Searches sequences through wider and wider layers."""
        taken, self._until = 0.0, until
        for width in WIDTHS:
            now = self._solver.clock.now()
            if self.optimal or now + GROWTH * taken > self._until or width * len(self._points) > self._most:
                break
            if self.narrow(width) < width:
                break
            taken = self._solver.clock.now() - now

    def prove(self) -> None:
        """Raises the lower bound until it meets the best cost or the time is over."""
        taken = 0.0
        self._raise(self.first_bound())
        while not self.optimal and not self._late():
            began = self._solver.clock.now()
            ceiling = self.best.bound + (0.0 if self._solver.whole_weights else self._solver.least_weight)
            if began + GROWTH * taken > self._until or not self._complete(min(ceiling, self.best.cost)):
                return
            taken = self._solver.clock.now() - began

    def _first_layer(self) -> Layer:
        """Returns the start as a layer before the first point; its exit is negative if it does not serve that."""
        return Layer(self._start, np.zeros(1), np.zeros(1, dtype=np.int64), *self.to_go.judged(0, self._start))

    def first_bound(self) -> float:
        """Returns what the thresholds and labels prove without a search."""
        start = self._first_layer()
        if start.exits[0] >= 0:
            return float(start.rest[0])
        step = 0.0 if self.to_go.places.fixed[0] else self._solver.least_weight
        return float(self.to_go.least[: self.to_go.labels.last[0] + 1].min()) + step

    def _late(self) -> bool:
        return self._solver.clock.now() > self._until or self._stop()

    def narrow(self, width: int) -> int:
        """Searches a sequence through layers of the cheapest configurations; returns the width of the widest layer."""
        layers = [self._first_layer()]
        for k in range(len(self._points)):
            following = self._cheapest(layers[-1], k, width)
            if following is None:
                self._join(layers)
                return width
            layers.append(following)
        self._offer_through(layers)
        return max(len(layer.costs) for layer in layers)

    def _join(self, layers: list[Layer]) -> None:
        """Offers the best sequence with its beginning replaced by layers that do not reach the end."""
        k, rows = len(layers) - 1, self.best.configurations
        if k == 0 or rows is None:
            return
        costs = layers[-1].costs + self._solver.cost(states_of(self.to_go.chain, layers[-1].keys), rows[k])
        n, rest = int(np.argmin(costs)), float(self._solver.cost(rows[k + 1 :], rows[k:-1]).sum())
        self.offer(np.vstack([self._trace(layers, n), rows[k:]]), float(costs[n]) + rest)

    def _complete(self, ceiling: float) -> bool:
        """Proves that each sequence costs more than `ceiling`, or finds the cheapest; False without time or space."""
        layers, room = [self._first_layer()], self._most
        for k in range(len(self._points)):
            following = self._next_layer(layers[-1], k, ceiling, min(MOST, room))
            if following is None:
                return False
            layers.append(following)
            room -= len(following.costs)
            if not len(following.costs):
                break
        unit = self._solver.least_weight if self._solver.whole_weights else 0.0
        found = len(layers[-1].costs) > 0
        if found:
            self._offer_through(layers)
        self._raise(float(layers[-1].costs.min()) if found else ceiling + unit)
        return True

    def _offer_through(self, layers: list[Layer]) -> None:
        n = int(np.argmin(layers[-1].costs))
        self.offer(self._trace(layers, n), float(layers[-1].costs[n]))

    def _cheapest(self, layer: Layer, k: int, width: int) -> Layer | None:
        """Returns about `width` of the cheapest configurations for point k; None if none is found in time."""
        least, found = self._solver.least_weight, None
        ceiling = float((layer.costs + self._low(k)).min())
        for steps in range(WIDER + 1):
            budgets = np.minimum(ceiling + least * steps - self._low(k) - layer.costs, self._most_budget)
            if found is not None and self.to_go.counts.prices(budgets).sum() > PRICE_OF_PLACE * width:
                break
            wider = self._next_layer(layer, k, ceiling + least * steps, ENOUGH * width + FEW_KEYS, True)
            if wider is None:
                break
            found = wider
            if len(found.costs) >= width:
                break
        if found is None or not len(found.costs):
            found = self._far(layer, k)
        if found is None or self._late():
            return None
        # Of two labels of equal cost the one that serves longer is better: a point is worth the mean cost so far.
        worth = found.costs + found.rest - float(found.costs.min()) / (k + 1) * (found.exits - k)
        chosen = np.argsort(worth, kind="stable")[:width]
        return found.of(chosen)

    def _far(self, layer: Layer, k: int) -> Layer | None:
        """Returns one configuration for a point that no neighbour serves, by a search for this goal alone."""
        n, chain, point = int(np.argmin(layer.costs)), self.to_go.chain, self._points[k]
        seed = states_of(chain, layer.keys[n : n + 1])[0]
        if point.configuration is not None:
            configuration = point.configuration
        else:
            solution = self._solver.solve(point.target, seed, timeout=FIRST, hurried=self._stop)
            if not solution.within_tolerance:
                return None
            configuration = solution.configuration
        key, cost = keys_of(chain, configuration), float(self._solver.cost(configuration, seed))
        return self._layer(k, [(key, layer.costs[n : n + 1] + cost, np.array([n]))], np.inf)

    def _low(self, k: int) -> float:
        """Returns the least threshold of a configuration that serves point k."""
        labels = self.to_go.labels
        return float(labels.thresholds[k : labels.last[k] + 1].min())

    def _layer(
        self, k: int, found: Sequence[tuple[Integers, Array, Integers]], ceiling: float, staying: Layer | None = None
    ) -> Layer:
        """Returns the cheapest of equal configurations for point k, up to a cost of the whole trajectory."""
        keys, costs, before = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
        layer = Layer(keys, costs, before, *self.to_go.judged(k, keys))
        if staying is not None:
            layer = Layer(*(np.concatenate(arrays) for arrays in zip(staying, layer, strict=True)))
        keep = np.flatnonzero(layer.costs + layer.rest <= ceiling * (1 + EPSILON))
        return layer.of(keep[cheapest(layer.keys[keep], layer.costs[keep])])

    def _next_layer(self, layer: Layer, k: int, ceiling: float, most: int, part: bool = False) -> Layer | None:
        """Returns all configurations for point k of sequences within a cost of the whole trajectory.

        Returns None if there are more than `most`, or if it is late. With `part`, some `most` of them suffice.
        """
        to_go, low, least, deeper = self.to_go, self._low(k), self._solver.least_weight, 0
        if self._late():
            return None
        room = ceiling * (1 + EPSILON) - layer.costs
        serves, (labels, values) = layer.exits >= k, self._labels(k)
        staying = np.flatnonzero(serves & (room >= layer.rest))
        moving = np.flatnonzero(~serves & (room >= float(to_go.least[k : to_go.labels.last[k] + 1].min())))
        budgets = room[moving] - low
        if part:
            order = np.random.default_rng(k).permutation(len(moving))
            moving, budgets = moving[order], np.minimum(budgets[order], self._most_budget)
        price = float(to_go.counts.prices(budgets).sum())
        while not part and deeper < DEEPER and len(values):
            compared = np.count_nonzero(values < low - deeper * least * (1 - EPSILON))
            further = float(to_go.counts.prices(budgets + (deeper + 1) * least).sum()) - price
            if compared * len(moving) * SCANNED < further:
                break
            deeper += 1
        found = self._neighbours(k, layer.keys[moving], budgets + deeper * least, most, part)
        if found is None:
            return None
        reached = [(found.keys, layer.costs[moving][found.sources] + found.costs, moving[found.sources])]
        few = np.flatnonzero(values < low - deeper * least * (1 - EPSILON))
        if part:
            few = few[np.argsort(values[few], kind="stable")[: int(price / (len(moving) * SCANNED + 1e-9))]]
        if len(few) and len(moving):
            pairs = near_labels(to_go.chain, layer.keys[moving], room[moving], labels[few], values[few])
            reached.append((pairs.keys, layer.costs[moving][pairs.sources] + pairs.costs, moving[pairs.sources]))
        return self._layer(k, reached, ceiling, layer.of(staying)._replace(before=staying))

    def _labels(self, k: int) -> tuple[Integers, Array]:
        """Returns keys (n,) and values (n,) of labels below the least threshold of a configuration for point k."""
        labels, part = self.to_go.labels, self.to_go.labels.of(k)
        keys, values = labels.keys[part], labels.values[part]
        below = values < self._low(k) * (1 - EPSILON)
        return keys[below], values[below]

    def _neighbours(self, k: int, keys: Integers, budgets: Array, most: int, part: bool) -> Pairs | None:
        """Lists neighbours in all threads, see Neighbours.near."""
        large = np.flatnonzero(budgets > self._most_listed)
        if self.to_go.tips is None or self.to_go.places.fixed[k] or not len(large):
            return self._listed(k, keys, budgets, most, part)
        listed = self._listed(k, keys, np.where(budgets > self._most_listed, -1.0, budgets), most, part)
        parts = [] if listed is None else [listed]
        for n in large[:MOST_LARGE].tolist():
            for found, costs in self.to_go.all_near(k, keys[n : n + 1], float(budgets[n])):
                parts.append(Pairs(np.full(len(costs), n), found, costs))
                if self._late() or sum(len(pairs.costs) for pairs in parts) > most:
                    return None
        return joined(parts) if listed is not None and len(large) <= MOST_LARGE else None

    def _listed(self, k: int, keys: Integers, budgets: Array, most: int, part: bool) -> Pairs | None:
        threads = self.to_go.neighbours if len(keys) >= FEW_KEYS else self.to_go.neighbours[:1]
        shares = [np.arange(n, len(keys), len(threads)) for n in range(len(threads))]

        def listed(neighbours: Neighbours, share: Integers) -> Pairs | None:
            found = neighbours.near(k, keys[share], budgets[share], most // len(threads), self._late, part)
            return None if found is None else found._replace(sources=share[found.sources])

        if len(threads) == 1:
            return listed(threads[0], shares[0])
        with ThreadPoolExecutor(len(threads)) as pool:
            found = list(pool.map(listed, threads, shares))
        parts = [part for part in found if part is not None]
        return joined(parts) if len(parts) == len(found) else None

    def _trace(self, layers: list[Layer], n: int) -> Integers:
        """Returns the sequence (len(layers) - 1, B) that ends in configuration `n` of the last layer."""
        keys = np.empty((len(layers) - 1, layers[0].keys.shape[1]), dtype=np.int64)
        for k in range(len(layers) - 1, 0, -1):
            keys[k - 1] = layers[k].keys[n]
            n = int(layers[k].before[n])
        return states_of(self.to_go.chain, keys)
