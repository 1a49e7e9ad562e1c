"""Fewest switches over a whole trajectory: label setting over complete candidate sets.

A layer holds configurations that serve one point, each with the cost of the cheapest known sequence that ends in it.
The next layer holds all configurations within the tolerances of the next point, up to a cost. A configuration is held
as long as it serves: switching sooner saves nothing, as costs obey the triangle inequality. Narrow layers give a plan.
Complete layers omit only what cannot be part of a sequence of at most some cost: they give the optimum, or prove that
no sequence costs so little.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.candidate_sets import CandidateSets
from controller.motion.lookahead import LookAhead
from controller.motion.trajectory import Trajectory
from controller.search.solution import EPSILON, proves
from controller.search.solver import Solver

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

WIDTHS = (4, 16, 64, 256, 1024, 4096, 16384)  # of layers, the next if there is time
GROWTH = 5.0  # how much longer the next width takes, and the next ceiling of a proof
WIDER = 4  # least weights by which costs rise at most, to find as many as a layer holds
SURE = 0.01  # [s] for a configuration that serves a point, so that it is known what to list
MOST = 1 << 18  # configurations of a complete layer
FARTHEST = 64  # points ahead, for which it is seen whether a configuration serves


class Layer(NamedTuple):
    """Configurations that serve a point.

    Attributes:
        configurations: shape (n, B).
        costs: of the cheapest way to each, shape (n,).
        before: number of the configuration before in the layer before, shape (n,).
    """

    configurations: NDArray[np.uint16]
    costs: Array
    before: Integers


class Whole(NamedTuple):
    """Configurations for all points of a trajectory.

    Attributes:
        configurations: shape (n, B); none if none were found.
        cost: weighted switches in all; infinite if none were found.
        bound: proven: no sequence of configurations that serve costs less.
    """

    configurations: Integers | None
    cost: float
    bound: float


class LabelSetting:
    """The search for fewest switches over one trajectory.

    Attributes:
        best: the cheapest sequence found, and what is proven.

    Args:
        solver: of the arm.
        trajectory: whose points are to be served.
        start: configuration before the first, shape (B,).
        stop: whether to stop for another reason than the time.
    """

    def __init__(
        self, solver: Solver, trajectory: Trajectory, start: Configuration, stop: Callable[[], bool] = lambda: False
    ) -> None:
        self._solver, self._trajectory, self._stop = solver, trajectory, stop
        self._sets = CandidateSets(solver.manipulator, solver.weights)
        self._until = np.inf
        self._start = Layer(np.asarray(start, np.uint16)[None], np.zeros(1), np.zeros(1, dtype=np.int64))
        self._rest = least_rest(trajectory, solver.least_weight)
        self.best = Whole(None, np.inf, float(self._rest[0]))

    @property
    def settled(self) -> bool:
        """Whether nothing better can be found."""
        return proves(self.best.bound, self.best.cost)

    def offer(self, configurations: Integers, cost: float, first: float = 0.0) -> None:
        """Takes a sequence (n, B) if it is cheaper than the best; `first`: least cost of coming to the first point."""
        self.best = self.best._replace(bound=max(self.best.bound, first + float(self._rest[0])))
        if cost < self.best.cost * (1 - EPSILON):
            self.best = self.best._replace(configurations=configurations, cost=cost)

    def run(self, seconds: float) -> Whole:
        """Returns the cheapest sequence found in a time [s], a fifth of it for a proof, and what is proven."""
        began = time.perf_counter()
        self._until = began + 0.8 * seconds
        self._look_ahead()
        taken = 0.0
        for width in WIDTHS:
            now = time.perf_counter()
            if self.settled or now + GROWTH * taken > self._until or self._narrow(width) < width:
                break
            taken = time.perf_counter() - now
        self._until = began + seconds
        self.prove()
        return self.best

    def _look_ahead(self) -> None:
        """Offers what the look-ahead of a running goal finds, with the best sequence's end if there is no more time."""
        trajectory, solver, count = self._trajectory, self._solver, 0
        search = LookAhead(solver, self._start.configurations[0].astype(np.int64), trajectory)
        while count < len(trajectory.times) and not self._late():
            search.extend()
            count += 1
        if count < len(trajectory.times) and (count == 0 or self.best.configurations is None):
            return
        rest = [] if self.best.configurations is None else list(self.best.configurations[count:])
        rows = np.array([self._start.configurations[0], *search.decide(count), *rest], dtype=np.int64)
        for k, row in enumerate(rows[1:]):
            tolerance, turn = float(trajectory.tolerances[k]), float(trajectory.turns[k])
            if not solver.described(row, trajectory.goal(k), row, tolerance, turn).within_tolerance:
                return
        self.offer(rows[1:], float(solver.cost(rows[1:], rows[:-1]).sum()))

    def prove(self) -> None:
        """Raises what is proven, the least cost that a sequence may have, until that is found or the time is over."""
        taken = 0.0
        while not self.settled and not self._late():
            began = time.perf_counter()
            ceiling = self.best.bound + (0.0 if self._solver.whole_weights else self._solver.least_weight)
            if began + GROWTH * taken > self._until or not self._complete(min(ceiling, self.best.cost)):
                return
            taken = time.perf_counter() - began

    def _late(self) -> bool:
        return time.perf_counter() > self._until or self._stop()

    def _narrow(self, width: int) -> int:
        """Looks for a sequence through layers of the cheapest configurations; returns the width of the widest."""
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
        """Offers the best sequence with another beginning, through layers that do not reach the end."""
        k, rows = len(layers) - 1, self.best.configurations
        if k == 0 or rows is None:
            return
        costs = layers[-1].costs + self._solver.cost(layers[-1].configurations, rows[k])
        n, rest = int(np.argmin(costs)), float(self._solver.cost(rows[k + 1 :], rows[k:-1]).sum())
        self.offer(np.vstack([trace(layers, n), rows[k:]]), float(costs[n]) + rest)

    def _complete(self, ceiling: float) -> bool:
        """Proves that no sequence costs so little, or finds the cheapest; False if there is no time or room for it."""
        layers = [self._start]
        for k, rest in enumerate(self._rest):
            following = self._following(layers[-1], k, ceiling - float(rest), MOST)
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
        """Offers the cheapest sequence through layers."""
        n = int(np.argmin(layers[-1].costs))
        self.offer(trace(layers, n), float(layers[-1].costs[n]))

    def _cheapest(self, layer: Layer, k: int, width: int) -> Layer | None:
        """Returns about so many of the cheapest configurations for point k; None if there are none or it is late."""
        least, solver, trajectory = float(layer.costs.min()), self._solver, self._trajectory
        seed = layer.configurations[int(np.argmin(layer.costs))].astype(np.int64)
        if k in trajectory.fixed:
            return self._following(layer, k, np.inf, MOST)
        tolerance, turn = float(trajectory.tolerances[k]), float(trajectory.turns[k])
        sure = solver.solve(trajectory.goal(k), seed, tolerance, deadline=SURE, angle_tolerance=turn)
        if not sure.within_tolerance or self._late():
            return None
        found = Layer(sure.configuration.astype(np.uint16)[None], np.array([least + sure.cost]), np.zeros(1, np.int64))
        found = found._replace(before=np.array([int(np.argmin(layer.costs))]))
        for more in range(WIDER):
            wider = self._following(layer, k, least + sure.cost + more * solver.least_weight, 64 * width + 1024)
            if wider is None:
                break
            found = wider
            if len(found.costs) >= width:
                break
        if self._late():
            return None
        # Of two ways of one cost the better is that which serves longer: a point costs what it did so far.
        worth = found.costs - float(found.costs.min()) / (k + 1) * self._until_when(found, k)
        chosen = np.argsort(worth, kind="stable")[:width]
        return Layer(found.configurations[chosen], found.costs[chosen], found.before[chosen])

    def _until_when(self, layer: Layer, k: int) -> Integers:
        """Returns for how many of the next points each configuration of a layer serves, shape (n,)."""
        tips = self._solver.manipulator.tips(layer.configurations)
        served = self._trajectory.serve(tips, slice(k + 1, k + 1 + FARTHEST))
        return np.asarray(np.logical_and.accumulate(served, axis=1).sum(axis=1))

    def _following(self, layer: Layer, k: int, ceiling: float, most: int) -> Layer | None:
        """Returns all configurations for point k that a way of at most a cost leads to; None if they are too many.

        Args:
            layer: the one before.
            k: the point.
            ceiling: greatest cost.
            most: configurations.
        """
        trajectory, solver = self._trajectory, self._solver
        if (states := trajectory.fixed.get(k)) is not None:
            return self._to(layer, solver.manipulator.configuration(states), ceiling)
        served = trajectory.serve(solver.manipulator.tips(layer.configurations), slice(k, k + 1))[:, 0]
        room = ceiling * (1 + EPSILON) - layer.costs
        kept, moved = np.flatnonzero(served & (room >= 0)), np.flatnonzero(~served & (room >= solver.least_weight))
        moved = moved[np.argsort(-room[moved], kind="stable")]
        target = solver.target(trajectory.goal(k), float(trajectory.tolerances[k]), float(trajectory.turns[k]))
        found = self._sets.find(target, layer.configurations[moved], room[moved], most, self._late)
        if found is None:
            return None
        before = np.concatenate([kept, moved[found.sources]])
        rows = np.concatenate([layer.configurations[kept], found.configurations])
        costs = layer.costs[before] + solver.cost(rows, layer.configurations[before])
        order = np.argsort(costs, kind="stable")
        _, first = np.unique(rows[order].view(f"V{2 * rows.shape[1]}"), return_index=True)
        chosen = order[first]
        return Layer(rows[chosen], costs[chosen], before[chosen])

    def _to(self, layer: Layer, configuration: Configuration, ceiling: float) -> Layer:
        """Returns the layer of one configuration (B,), if the cost of the cheapest way there is at most a ceiling."""
        costs = layer.costs + self._solver.cost(layer.configurations, configuration)
        n = int(np.argmin(costs)) if len(costs) else 0
        count = int(len(costs) > 0 and costs[n] <= ceiling)
        rows = np.asarray(configuration, np.uint16)[None]
        return Layer(rows[:count], costs[n : n + count], np.full(count, n))


def trace(layers: list[Layer], n: int) -> Integers:
    """Returns the configurations (len(layers) - 1, B) that lead to configuration `n` of the last layer."""
    rows = np.empty((len(layers) - 1, layers[0].configurations.shape[1]), dtype=np.int64)
    for k in range(len(layers) - 1, 0, -1):
        rows[k - 1] = layers[k].configurations[n]
        n = int(layers[k].before[n])
    return rows


def least_rest(trajectory: Trajectory, least: float) -> Array:
    """Returns what the points after each one cost at least, whatever configuration serves that one, shape (n,).

    Two points that are farther apart than their tolerances need a switch between them.
    """
    count = len(trajectory.times)
    result = np.zeros(count)
    slack = EPSILON * (1.0 + float(np.abs(trajectory.positions).max(initial=0.0)))
    for k in range(count - 2, -1, -1):
        result[k] = result[k + 1]
        ahead = slice(k + 1, min(k + 1 + FARTHEST, count))
        apart = np.linalg.norm(trajectory.positions[ahead] - trajectory.positions[k], axis=1)
        beyond = np.flatnonzero(apart > trajectory.tolerances[ahead] + trajectory.tolerances[k] + slack)
        if len(beyond):
            result[k] = max(result[k], least + result[k + 1 + int(beyond[0])])
    return result
