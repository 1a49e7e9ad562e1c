"""Fewest switches over a whole trajectory: label setting over complete candidate sets.

A layer holds configurations that serve one point, each with the cost of the cheapest known sequence that ends in it.
The next layer holds all configurations within the tolerances of the next point, up to a cost. A configuration stays as
long as it serves: switching sooner saves nothing, as costs obey the triangle inequality. Narrow layers give a plan.
Complete layers contain every configuration that a sequence within the cost can pass. They give the optimum, or prove
that each sequence costs more.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.candidate_sets import CandidateSets
from hyperbit.controller.motion.plans.lookahead import LookAhead
from hyperbit.controller.motion.plans.points import FARTHEST, TrajectoryPoints
from hyperbit.controller.motion.trajectory import Trajectory
from hyperbit.controller.search.solution import EPSILON, SearchTime, proves

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

WIDTHS = (4, 16, 64, 256, 1024, 4096, 16384)  # of layers, one after the other while there is time
GROWTH = 5.0  # expected factor of the time from one width, or one ceiling of a proof, to the next
WIDER = 4  # most steps of one least weight by which the ceiling rises to fill a layer
FIRST = SearchTime(0.01, unfound=0.5)  # to find one configuration that serves a point; its cost is the first ceiling
MOST = 1 << 18  # configurations of a complete layer


class Layer(NamedTuple):
    """Configurations that serve a point."""

    configurations: NDArray[np.uint16]  # shape (n, B)
    costs: Array  # of the cheapest sequence to each, shape (n,)
    before: Integers  # index of the predecessor in the layer before, shape (n,)


class BestSequence(NamedTuple):
    """The cheapest sequence found of configurations that serve all points of a trajectory."""

    configurations: Integers | None  # shape (n, B); None if no sequence was found
    cost: float  # weighted switches; infinite if no sequence was found
    bound: float  # proven lower bound of the cost of any sequence


class LabelSetting:
    """The search for fewest switches over one trajectory.

    It begins in the configuration `start` (B,), and ends early if `stop` returns true.

    Attributes:
        best: the cheapest sequence found and the proven lower bound.
    """

    def __init__(
        self, points: TrajectoryPoints, start: Configuration, stop: Callable[[], bool] = lambda: False
    ) -> None:
        self._points, self._stop = points, stop
        self._solver, self._trajectory = solver, trajectory = points.solver, points.trajectory
        self._sets = CandidateSets(solver.manipulator, solver.weights)
        self._until = np.inf
        self._start = Layer(np.asarray(start, np.uint16)[None], np.zeros(1), np.zeros(1, dtype=np.int64))
        self._rest = least_remaining_cost(trajectory, solver.least_weight)
        self.best = BestSequence(None, np.inf, float(self._rest[0]))

    @property
    def optimal(self) -> bool:
        return proves(self.best.bound, self.best.cost)

    def offer(self, configurations: Integers, cost: float, first: float = 0.0) -> None:
        """Takes a sequence (n, B) if it is cheaper than the best; `first` is a lower bound of the first step's cost."""
        self.best = self.best._replace(bound=max(self.best.bound, first + float(self._rest[0])))
        if cost < self.best.cost * (1 - EPSILON):
            self.best = self.best._replace(configurations=configurations, cost=cost)

    def run(self, seconds: float) -> BestSequence:
        """Searches for a time [s], of which a fifth is for a proof; returns the best sequence and its bound."""
        began = time.perf_counter()
        self._until = began + 0.8 * seconds
        self._look_ahead()
        taken = 0.0
        for width in WIDTHS:
            now = time.perf_counter()
            if self.optimal or now + GROWTH * taken > self._until or self._narrow(width) < width:
                break
            taken = time.perf_counter() - now
        self._until = began + seconds
        self.prove()
        return self.best

    def _look_ahead(self) -> None:
        """Offers the result of look-ahead; if the time is short, its beginning with the end of the best sequence."""
        trajectory, solver, count = self._trajectory, self._solver, 0
        search = LookAhead(self._points, self._start.configurations[0].astype(np.int64))
        while count < len(trajectory.times) and not self._late():
            search.extend()
            count += 1
        if count < len(trajectory.times) and (count == 0 or self.best.configurations is None):
            return
        rest = [] if self.best.configurations is None else list(self.best.configurations[count:])
        rows = np.array([self._start.configurations[0], *search.decide(count), *rest], dtype=np.int64)
        if not all(solver.feasible(point.target, row) for point, row in zip(self._points, rows[1:], strict=True)):
            return
        self.offer(rows[1:], float(solver.cost(rows[1:], rows[:-1]).sum()))

    def prove(self) -> None:
        """Raises the lower bound until it meets the best cost or the time is over."""
        taken = 0.0
        while not self.optimal and not self._late():
            began = time.perf_counter()
            ceiling = self.best.bound + (0.0 if self._solver.whole_weights else self._solver.least_weight)
            if began + GROWTH * taken > self._until or not self._complete(min(ceiling, self.best.cost)):
                return
            taken = time.perf_counter() - began

    def _late(self) -> bool:
        return time.perf_counter() > self._until or self._stop()

    def _narrow(self, width: int) -> int:
        """Searches a sequence through layers of the cheapest configurations; returns the width of the widest layer."""
        layers = [self._start]
        for k in range(len(self._trajectory.times)):
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
        costs = layers[-1].costs + self._solver.cost(layers[-1].configurations, rows[k])
        n, rest = int(np.argmin(costs)), float(self._solver.cost(rows[k + 1 :], rows[k:-1]).sum())
        self.offer(np.vstack([trace(layers, n), rows[k:]]), float(costs[n]) + rest)

    def _complete(self, ceiling: float) -> bool:
        """Proves that each sequence costs more than `ceiling`, or finds the cheapest; False without time or space."""
        layers = [self._start]
        for k, rest in enumerate(self._rest):
            following = self._next_layer(layers[-1], k, ceiling - float(rest), MOST)
            if following is None:
                return False
            layers.append(following)
            if not len(following.costs):
                break
        unit = self._solver.least_weight if self._solver.whole_weights else 0.0
        least = float(layers[-1].costs.min()) if len(layers[-1].costs) else ceiling + unit
        if len(layers[-1].costs):
            self._offer_through(layers)
        self.best = self.best._replace(bound=max(self.best.bound, least))
        return True

    def _offer_through(self, layers: list[Layer]) -> None:
        n = int(np.argmin(layers[-1].costs))
        self.offer(trace(layers, n), float(layers[-1].costs[n]))

    def _cheapest(self, layer: Layer, k: int, width: int) -> Layer | None:
        """Returns about `width` of the cheapest configurations for point k; None if none is found in time."""
        least, solver, point = float(layer.costs.min()), self._solver, self._points[k]
        seed = layer.configurations[int(np.argmin(layer.costs))].astype(np.int64)
        if point.states is not None:
            return self._next_layer(layer, k, np.inf, MOST)
        solution = solver.solve(point.target, seed, timeout=FIRST)
        if not solution.within_tolerance or self._late():
            return None
        row, before = solution.configuration.astype(np.uint16)[None], np.array([np.argmin(layer.costs)])
        found = Layer(row, np.array([least + solution.cost]), before)
        for more in range(WIDER):
            wider = self._next_layer(layer, k, least + solution.cost + more * solver.least_weight, 64 * width + 1024)
            if wider is None:
                break
            found = wider
            if len(found.costs) >= width:
                break
        if self._late():
            return None
        # Of two labels of equal cost the one that serves longer is better: a point is worth the mean cost so far.
        served = self._points.count_served(found.configurations, k + 1)
        worth = found.costs - float(found.costs.min()) / (k + 1) * served
        chosen = np.argsort(worth, kind="stable")[:width]
        return Layer(found.configurations[chosen], found.costs[chosen], found.before[chosen])

    def _next_layer(self, layer: Layer, k: int, ceiling: float, most: int) -> Layer | None:
        """Returns all configurations for point k at the end of sequences within a cost; None if more than `most`."""
        solver, point = self._solver, self._points[k]
        if (given := point.configuration) is not None:
            return self._given_layer(layer, given, ceiling)
        served = self._trajectory.serve(solver.manipulator.tips(layer.configurations), slice(k, k + 1))[:, 0]
        room = ceiling * (1 + EPSILON) - layer.costs
        staying, moving = np.flatnonzero(served & (room >= 0)), np.flatnonzero(~served & (room >= solver.least_weight))
        moving = moving[np.argsort(-room[moving], kind="stable")]
        found = self._sets.find(point.target, layer.configurations[moving], room[moving], most, self._late)
        if found is None:
            return None
        before = np.concatenate([staying, moving[found.sources]])
        rows = np.concatenate([layer.configurations[staying], found.configurations])
        costs = layer.costs[before] + solver.cost(rows, layer.configurations[before])
        order = np.argsort(costs, kind="stable")
        _, first = np.unique(rows[order].view(f"V{2 * rows.shape[1]}"), return_index=True)
        chosen = order[first]
        return Layer(rows[chosen], costs[chosen], before[chosen])

    def _given_layer(self, layer: Layer, configuration: Configuration, ceiling: float) -> Layer:
        """Returns the layer of one configuration (B,); it is empty if each sequence to it costs more than `ceiling`."""
        costs = layer.costs + self._solver.cost(layer.configurations, configuration)
        n = int(np.argmin(costs)) if len(costs) else 0
        count = int(len(costs) > 0 and costs[n] <= ceiling)
        rows = np.asarray(configuration, np.uint16)[None]
        return Layer(rows[:count], costs[n : n + count], np.full(count, n))


def trace(layers: list[Layer], n: int) -> Integers:
    """Returns the sequence (len(layers) - 1, B) that ends in configuration `n` of the last layer."""
    rows = np.empty((len(layers) - 1, layers[0].configurations.shape[1]), dtype=np.int64)
    for k in range(len(layers) - 1, 0, -1):
        rows[k - 1] = layers[k].configurations[n]
        n = int(layers[k].before[n])
    return rows


def least_remaining_cost(trajectory: Trajectory, least: float) -> Array:
    """Returns a lower bound of the cost of the points after each point, for any configuration there, shape (n,).

    Two points that are farther apart than the sum of their tolerances need a switch between them.
    """
    count = len(trajectory.times)
    result = np.zeros(count)
    slack = EPSILON * (1.0 + float(np.abs(trajectory.positions).max(initial=0.0)))
    for k in range(count - 2, -1, -1):
        result[k] = result[k + 1]
        ahead = slice(k + 1, min(k + 1 + FARTHEST, count))
        apart = np.linalg.norm(trajectory.positions[ahead] - trajectory.positions[k], axis=1)
        out_of_range = np.flatnonzero(apart > trajectory.tolerances[ahead] + trajectory.tolerances[k] + slack)
        if len(out_of_range):
            result[k] = max(result[k], least + result[k + 1 + int(out_of_range[0])])
    return result
