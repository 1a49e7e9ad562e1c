"""Lower bounds of the cost to go at each point of a trajectory, computed from its end: labels from behind.

A configuration stays as long as it serves: switching sooner saves nothing, as costs obey the triangle inequality. It
leaves at its exit, the last point that it serves without a gap. Each point k has a threshold D_k and labels: every
configuration with exit k costs at least D_k from there, or has a label with a lower bound of its cost. The step from
point k + 1 to k lists all configurations with exit k near those that serve k + 1, as far as D_k asks for.
"""

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.motion.plans.backward_step import COMPARED, DEEPEST_STEP, LEAF, SHALLOWEST, Step
from hyperbit.controller.motion.plans.labels import Labels, judged
from hyperbit.controller.motion.plans.points import TrajectoryPoint
from hyperbit.controller.obstacles.scene import scene_of
from hyperbit.controller.search.neighbours.chain import Places, places_of, states_of
from hyperbit.controller.search.neighbours.counts import Counts
from hyperbit.controller.search.neighbours.neighbours import Late, Neighbours
from hyperbit.controller.search.neighbours.pairs import by_bits
from hyperbit.controller.search.neighbours.serving import UpperTips, Walk, serving, upper_tips, walks
from hyperbit.controller.search.solution import EPSILON
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.search.target import SearchTarget

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LIMITS = 64  # how often the time of a step is set anew
MOST_ROWS = 1 << 22  # changes of one configuration
TIPS_PER_SECOND, FEWEST_TIPS = 5e5, 1 << 12  # tips of the upper modules
NEAR_START = 1e-5  # share of the configurations near the start that serve a point, at least
LEAST_PART = 4.0  # a step may take this part of the mean time of a step, at least
SAMPLES, FEW_POINTS = 512, 200  # positions that show which exits are frequent, and points for which it is known
LEAST_SPENT = 1.0  # [s] of work by which the speed of the computer is known


def farthest_exits(places: Places) -> Integers:
    """Returns the last point that a configuration may serve without a gap from each point on, shape (n,)."""
    count = len(places.radii)
    last = np.arange(count)
    for k in range(count - 2, -1, -1):
        ahead = slice(k + 1, int(last[k + 1]) + 1)
        apart = np.linalg.norm(places.positions[ahead] - places.positions[k], axis=1)
        far = places.fixed[ahead] | (apart > (places.radii[ahead] + places.radii[k]) * (1 + EPSILON))
        last[k] = k + int(np.argmax(far)) if far.any() else last[k + 1]
    return last


class CostToGo:
    """The cost to go along one trajectory: thresholds from distances at first, and labels after `sweep`.

    Attributes:
        chain, places: arm and points for kernels.
        labels: see Labels.
        least: a lower bound of the cost to go of all configurations with exit k, shape (n,).
        neighbours: one for each thread.
    """

    def __init__(
        self, solver: Solver, points: Sequence[TrajectoryPoint], threads: int, most_labels: int, most_tips: int
    ) -> None:
        count = len(points)
        self.chain, self._solver, self._most_tips = solver.chain, solver, most_tips
        self.places = places_of(self.chain, [(point.target, point.configuration) for point in points])
        memory, none = (np.empty(most_labels, np.int64), np.empty(most_labels)), np.zeros(count, np.int64)
        self.labels = Labels(*memory, none, none.copy(), np.zeros(count), farthest_exits(self.places))
        self.least, self.used, self.unit = np.zeros(count), 0, self.chain.least if self.chain.whole else 0.0
        self._level(count - 1)
        scenes = [scene_of(solver.manipulator, solver.clearance) for _ in range(threads)]
        rows = min(most_labels >> 3, MOST_ROWS)
        self.neighbours = [Neighbours(self.chain, self.places, scene, rows) for scene in scenes]
        self.counts = self._lower = Counts(self.chain, len(self.chain.states))
        self.tips: UpperTips | None = None
        self._shares, self._lists = dict[int, Array](), dict[int, Integers | None]()
        self._most_serving = most_labels >> 2
        self._serving = np.array([expected(solver, point.target) for point in points])
        self.joins = by_bits(self.chain) & (self._serving < self._most_serving) & ~self.places.fixed
        self.half = Counts(self.chain, len(self.chain.states) // 2)

    def _level(self, end: int) -> None:
        """Sets the thresholds of all points before `end` to what the distances of the points prove."""
        for k in range(end - 1, -1, -1):
            step = 0.0 if self.places.fixed[k + 1] else self.chain.least
            self.least[k] = self.labels.thresholds[k] = step + self.least[k + 1 : self.labels.last[k + 1] + 1].min()

    def judged(self, k: int, keys: Integers) -> tuple[Array, Integers]:
        """Returns lower bounds of the cost to go, and exits, of keys (n, words) at point k, see `judge`."""
        return judged(self.neighbours[0], self.labels, k, keys)

    def list_tips(self, seconds: float) -> None:
        """Lists tips of the upper modules, as many as pay in a search of some time."""
        if self.chain.words[-1] == 0:
            most = int(min(self._most_tips, max(TIPS_PER_SECOND * seconds, FEWEST_TIPS)))
            self.tips = upper_tips(self.chain, most, float(self.places.radii.min()))
            self._lower = Counts(self.chain, self.tips.cut)

    def sweep(self, start: Integers, incumbent: float, seconds: float, late: Late) -> None:
        """Computes labels from the last point to the first.

        Args:
            start: key of the start (1, words).
            incumbent: cost of a plan; configurations that cannot be part of a cheaper one are left out.
            seconds: about how long it may take. The prices of the work decide; a slower computer lowers it further.
            late: whether to end at once; the labels of the points behind stay.
        """
        count, self._incumbent = len(self.least), incumbent
        if self.tips is None or count == 1:
            return
        self.used, self.labels.begins[:], self.labels.ends[:] = 0, 0, 0
        near = self.chain.costs[np.arange(len(self.chain.states)), states_of(self.chain, start)[0]]
        self.near, self._lists = np.ascontiguousarray(near), {}
        clock, threads = self._solver.clock, len(self.neighbours)
        work, began = seconds * threads, clock.now()
        spent, limit, deepest = 0.0, 0.0, DEEPEST_STEP
        for k in range(count - 2, -1, -1):
            taken = clock.now() - began
            speed = min(spent / (threads * taken), 1.0) if spent > LEAST_SPENT else 0.7
            work = min(work, (seconds - taken) * threads * speed)
            if (count - 2 - k) % max(count // LIMITS, 1) == 0:
                limit, deepest = self._limit(k, work)
            step = Step(self, k, self.near, incumbent, late)
            depth = step.depth(limit, deepest)
            while depth is not None and not step.run(depth):
                depth = depth - 1 if depth > SHALLOWEST and not late() else None
            work, spent = work - step.spent, spent + step.spent
            if depth is None:
                self._level(k + 1)
                return

    def all_near(self, k: int, key: Integers, budget: float) -> Iterator[tuple[Integers, Array]]:
        """Yields keys (n, 1) that serve point k within any budget of one key (1, 1), and their costs (n,)."""
        assert self.tips is not None
        modules = np.arange(len(self.chain.states))
        near = np.ascontiguousarray(self.chain.costs[modules, states_of(self.chain, key)[0]])
        where = self.places.positions[k], float(self.places.radii[k])
        for walk in walks(self.chain, self.tips, near):
            for found in serving(self.chain, self.tips, walk, near, budget * (1 + EPSILON), *where):
                keys = found[:, None]
                yield keys, near[modules, states_of(self.chain, keys)].sum(axis=1)

    def all_serving(self, k: int, limit: float, late: Late) -> Integers | None:
        """Returns all keys (n,) that serve point k, and others close to it; None if there is no room or time.

        Their cost from the start is below a limit.
        """
        if k not in self._lists:
            tips, near = self.tips, self.near
            assert tips is not None
            self._lists = {i: keys for i, keys in self._lists.items() if i == k + 1}
            where = self.places.positions[k], float(self.places.radii[k])
            parts, room = list[Integers](), [self._most_serving]

            def listed(walk: Walk) -> None:
                for found in serving(self.chain, tips, walk, near, limit * (1 + EPSILON), *where):
                    parts.append(found)
                    room[0] -= len(found)
                    if room[0] < 0 or late():
                        room[0] = -1
                        return

            with ThreadPoolExecutor(len(self.neighbours)) as pool:
                list(pool.map(listed, walks(self.chain, tips, near)))
            self._lists[k] = np.sort(np.concatenate([np.empty(0, np.int64), *parts])) if room[0] >= 0 else None
        return self._lists[k]

    def share(self, k: int) -> float:
        """Returns about which share of all configurations serves point k."""
        return float(self._serving[k] / self.counts.all)

    def expected(self, k: int, limit: float) -> tuple[float, float]:
        """Returns how long it takes to list what serves point k within a cost [s], and how many these are, about."""
        share = max(self.share(k), NEAR_START)
        time = LEAF * self._lower.within(limit) + COMPARED * self._serving[k]
        return time, min(self._serving[k], 1.0 + share * self.counts.within(limit))

    def shares(self, k: int) -> Array:
        """Returns which share of the configurations that serve point k has which exit, about, from k on."""
        if k in self._shares:
            return self._shares[k]
        last, places, size = int(self.labels.last[k]), self.places, 2 if self.chain.motions.shape[1] == 4 else 3
        points = np.random.default_rng(0).uniform(-1, 1, (SAMPLES, size))
        points = points[(points**2).sum(axis=1) <= 1] * places.radii[k] + places.positions[k, :size]
        away = np.linalg.norm(points[:, None] - places.positions[k : last + 1, :size], axis=2)
        served = np.logical_and.accumulate(away <= places.radii[k : last + 1], axis=1).sum(axis=1)
        self._shares[k] = np.asarray(np.bincount(np.maximum(served, 1) - 1, minlength=last - k + 1) / len(points))
        return self._shares[k]

    def _prices(self, k: int, budgets: Array) -> Array:
        """Returns the times [s] for one configuration of each point from the second to k + 1, and each budget (m,)."""
        near = self.counts.prices(budgets)
        joins = np.array([self.joins[i] and self.joins[i - 1] for i in range(1, k + 2)])
        return np.where(joins[:, None], np.minimum(near, self.half.joins(budgets, self.chain.least)), near)

    def _limit(self, k: int, work: float) -> tuple[float, int]:
        """Returns time [s] and greatest depth of one step, so that all steps to the first point take about `work`.

        Each step gains about as much by the next depth, so the cheapest are taken. If configurations serve several
        points, a step gains nothing alone: all steps get the same depth.
        """
        costs = self.chain.least * np.arange(1.0, DEEPEST_STEP)
        parts = np.array([self.expected(i, self._incumbent - self.unit - self.least[i]) for i in range(1, k + 2)])
        far = np.array([[self.shares(i)[-1] if k < FEW_POINTS else 1.0] for i in range(1, k + 2)])
        deep, shallow = (self._prices(k, budgets) for budgets in (costs, costs - self.chain.least))
        prices = far * deep + (1 - far) * shallow
        times = parts[:, :1] + parts[:, 1:] * prices
        least = work / (LEAST_PART * (k + 1))
        if (self.labels.last[: k + 1] > np.arange(k + 1)).mean() > 0.5:
            depth = int(np.count_nonzero(times.sum(axis=0) <= work))
            return max(float(times[:, depth - 1].max()) if depth else 0.0, least), 1 + depth if depth < len(
                costs
            ) else DEEPEST_STEP
        limits = np.sort(times.ravel())
        low, high = 0, len(limits)
        while low < high:
            middle = (low + high) // 2
            if np.where(times <= limits[middle], times, 0.0).max(axis=1).sum() <= work:
                low = middle + 1
            else:
                high = middle
        return max(float(limits[low - 1]) if low else 0.0, least), DEEPEST_STEP


def expected(solver: Solver, target: SearchTarget) -> float:
    """Returns about how many configurations serve a target, by the point densities."""
    densities, planar = solver.densities, solver.manipulator.planar
    pixel = np.round((target.position - densities.references[0]) / densities.pixels[0]).astype(int)[::-1]
    if (pixel < 0).any() or (pixel >= densities.shapes[0]).any():
        return 1.0
    size = math.pi * target.tolerance**2 if planar else 4 / 3 * math.pi * target.tolerance**3
    share = target.share if target.oriented else 1.0
    return (
        1.0
        + math.exp(max(float(densities.level(0)[tuple(pixel)]), 0.0))
        * size
        / densities.volume(0, planar=planar)
        * share
    )
