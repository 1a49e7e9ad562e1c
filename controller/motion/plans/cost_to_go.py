"""Lower bounds of the cost to go at each point of a trajectory, computed from its end: labels from behind.

A configuration stays as long as it serves: switching sooner saves nothing, as costs obey the triangle inequality. It
leaves at its exit, the last point that it serves without a gap. Each point k has a threshold D_k and labels: every
configuration with exit k costs at least D_k from there, or has a label with a lower bound of its cost. The step from
point k + 1 to k lists all configurations with exit k near those that serve k + 1, as far as D_k asks for.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import NamedTuple

import numpy as np
from numba import int64, njit, types
from numpy.typing import NDArray

from hyperbit.controller.manipulator.kernel_types import F1, I1, I2, UNCOUNTED, named
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.obstacles.scene import Scene, for_scenes, scene_of
from hyperbit.controller.search.changes import (
    CHAIN,
    CHANGED,
    PLACES,
    Chain,
    Changed,
    Found,
    Places,
    chain_of,
    fits,
    keys_of,
    list_near,
    room_for_changes,
    state_of,
    states_of,
)
from hyperbit.controller.search.serving import UpperTips, Walk, list_serving, reaches, upper_tips, walks
from hyperbit.controller.search.solution import EPSILON
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.search.target import SearchTarget

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LISTED, ROWS = 1 << 16, 1 << 12  # configurations and changes for which there is room at first
MOST_ROWS = 1 << 20  # changes of one configuration
SHARE = 1 << 14  # configurations that a thread takes at once
AT_ONCE, AT_ONCE_IN_PART = 512, 64  # those between two checks of the deadline, or of the number found
LABELS_OF_POINT = 1 << 21  # labels of one point, at most
MOST_LEAVES = 1 << 28  # configurations of the lower modules that are tried for one point
MOST_FOUND = 1 << 22  # labels found from SHARE configurations
SHALLOWEST, DEEPEST_STEP = -8, 12  # least and greatest rise of a threshold in one step, in least weights
LIMITS = 64  # how often the time of a step is set anew
SAMPLES = 512  # positions that show which exits are frequent
# Prices [s]: a configuration of the lower modules; a configuration that serves a point; the neighbours of one, among n
# configurations: 2 us + 10 ns * n^0.75. A step that takes SLACK_OF_WORK times as long as expected is given up.
LEAF, JUDGED, FIRST_PRICE, PRICE, POWER, SLACK_OF_WORK = 40e-9, 0.3e-6, 2e-6, 10e-9, 0.75, 4.0
TIPS_PER_SECOND, FEWEST_TIPS = 5e5, 1 << 12  # tips of the upper modules
LEAST_SPENT = 1.0  # [s] of work by which the speed of the computer is known
PARTS, DEEPEST = 4, 40  # steps of prices in a least weight; greatest budget with a price of its own


class Labels(NamedTuple):
    """Lower bounds of the cost to go of configurations with exit k: labels, and the threshold of all others."""

    keys: Integers  # of all labels, those of each point sorted, shape (m,)
    values: Array  # shape (m,)
    begins: Integers  # first label of each point, shape (n,)
    ends: Integers  # shape (n,)
    thresholds: Array  # shape (n,)
    last: Integers  # farthest exit of a configuration that serves each point, shape (n,)


class Pairs(NamedTuple):
    """Configurations near others."""

    sources: Integers  # number of the other, shape (n,)
    keys: Integers  # shape (n, words)
    costs: Array  # between the two, shape (n,)


Late = Callable[[], bool]
LABELS = named(Labels, I1, F1, I1, I1, F1, I1)


@njit(
    for_scenes(lambda scene: types.void(CHAIN, PLACES, LABELS, scene, int64, I2, CHANGED, F1, I1)),
    **UNCOUNTED,
    error_model="numpy",
)
def judge(
    chain: Chain,
    places: Places,
    labels: Labels,
    scene: Scene | None,
    k: int,
    keys: Integers,
    changed: Changed,
    rest: Array,
    exits: Integers,
) -> None:
    """Writes a lower bound of the cost to go of keys (n, words) at point k, and their exits.

    It is infinite for a configuration that does not serve point k, or collides.
    """
    for n in range(len(keys)):
        if not fits(chain, places, k, scene, changed.frames, keys, n, changed.module_states):
            rest[n], exits[n] = np.inf, -1
            continue
        exit = k
        while exit < labels.last[k] and fits(
            chain, places, exit + 1, None, changed.frames, keys, n, changed.module_states
        ):
            exit += 1
        low, high = labels.begins[exit], labels.ends[exit]
        end, key = high, keys[n, 0]
        while low < high:
            middle = (low + high) >> 1
            if labels.keys[middle] < key:
                low = middle + 1
            else:
                high = middle
        rest[n], exits[n] = labels.thresholds[exit], exit
        if low < end and labels.keys[low] == key:
            rest[n] = labels.values[low]


@njit(int64(CHAIN, I2, F1, I1, F1, I1, I1, F1), **UNCOUNTED)
def scan(
    chain: Chain,
    keys: Integers,
    rooms: Array,
    labels: Integers,
    values: Array,
    sources: Integers,
    targets: Integers,
    costs: Array,
) -> int:
    """Lists the pairs of a key (n, 1) and a label (m,) whose cost and value are within the key's room (n,).

    Returns their number, or -1 if there is no room for them.
    """
    count, modules = 0, len(chain.states)
    for n in range(len(keys)):
        for m in range(len(labels)):
            most, cost = rooms[n] - values[m], 0.0
            i, differ = 0, keys[n, 0] ^ labels[m]
            while differ != 0 and i < modules and cost <= most:
                if (differ >> chain.shifts[i]) & chain.masks[i] != 0:
                    one = (labels[m] >> chain.shifts[i]) & chain.masks[i]
                    cost += chain.costs[i, state_of(chain, keys, n, i), one]
                i += 1
            if cost <= most:
                if count == len(sources):
                    return -1
                sources[count], targets[count], costs[count] = n, labels[m], cost
                count += 1
    return count


class Neighbours:
    """Lists configurations near others for one thread; holds the memory for it."""

    def __init__(self, chain: Chain, places: Places, scene: Scene | None) -> None:
        self.chain, self.places, self.scene = chain, places, scene
        self.changed, self._found = room_for_changes(chain, ROWS), self._room(LISTED)

    def _room(self, rows: int) -> Found:
        words = int(self.chain.words[-1]) + 1
        return Found(np.empty(rows, np.int64), np.empty((rows, words), np.int64), np.empty(rows), np.zeros(1, np.int64))

    def judged(self, labels: Labels, k: int, keys: Integers) -> tuple[Array, Integers]:
        """Returns lower bounds of the cost to go, and exits, of keys (n, words) at point k, see `judge`."""
        rest, exits = np.empty(len(keys)), np.empty(len(keys), np.int64)
        judge(self.chain, self.places, labels, self.scene, k, keys, self.changed, rest, exits)
        return rest, exits

    def near(self, k: int, keys: Integers, budgets: Array, most: int, late: Late, part: bool = False) -> Pairs | None:
        """Returns configurations that serve point k within a budget (n,) of keys (n, words).

        Returns None if they are more than `most`, if `late()` becomes true, or if a budget is too large. With `part`,
        some `most` of them suffice.
        """
        if not len(keys):
            return Pairs(np.empty(0, np.int64), keys, budgets)
        parts, first, total = list[Pairs](), 0, 0
        while first < len(keys):
            self._found.written[0] = 0
            some = slice(first, first + (AT_ONCE_IN_PART if part else AT_ONCE))
            done = list_near(
                self.chain, self.places, k, self.scene, keys[some], budgets[some], self.changed, self._found
            )
            rows, count = len(self.changed.links), int(self._found.written[0])
            if done < 0:
                if rows >= MOST_ROWS:
                    return None
                self.changed = room_for_changes(self.chain, 4 * rows)
            elif count == 0 and done == 0:
                self._found = self._room(4 * len(self._found.sources))
            found = self._found
            parts.append(Pairs(found.sources[:count] + first, found.keys[:count].copy(), found.costs[:count].copy()))
            first, total = first + (done if done >= 0 else -done - 1), total + count
            if part and total >= most:
                break
            if total > most or (first < len(keys) and late()):
                return None
        return joined(parts)


def joined(parts: Sequence[Pairs]) -> Pairs:
    return Pairs(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def cheapest(keys: Integers, values: Array) -> Integers:
    """Returns the rows of the least value of each key (n, words), in the order of the keys."""
    order = np.lexsort((values, *keys.T[::-1]))
    ordered = keys[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order[new]


def places_of(points: TrajectoryPoints, chain: Chain) -> Places:
    """Returns the points of a trajectory for kernels."""
    targets, fixed = [point.target for point in points], points.trajectory.fixed
    size = 2 if chain.motions.shape[1] == 4 else 3
    given = np.zeros((len(targets), int(chain.words[-1]) + 1), np.int64)
    for k in fixed:
        if (configuration := points[k].configuration) is not None:
            given[k] = keys_of(chain, configuration)[0]
    return Places(
        np.array([target.position for target in targets]),
        np.array([target.row[size:] for target in targets]),
        np.array([target.radius for target in targets]),
        np.array([target.chord if target.oriented else np.inf for target in targets]),
        np.array([k in fixed for k in range(len(targets))], dtype=np.bool_),
        given,
    )


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


class Prices:
    """About how long lists of neighbours take, by their budgets."""

    def __init__(self, chain: Chain) -> None:
        self._unit = chain.least / PARTS
        counts = np.zeros(PARTS * DEEPEST)
        counts[0] = 1.0
        for i, k in enumerate(chain.states.tolist()):
            following = np.zeros_like(counts)
            for shift in np.floor(chain.costs[i, 0, :k] / self._unit + 1e-6).astype(int).tolist():
                following[shift:] += counts[: len(counts) - shift] if shift < len(counts) else 0.0
            counts = following
        self._prices = FIRST_PRICE + PRICE * np.cumsum(counts) ** POWER

    def of(self, budgets: Array) -> Array:
        """Returns the times [s] for budgets (...)."""
        at = np.clip(np.floor(budgets / self._unit + 1e-6), -1, len(self._prices) - 1).astype(int)
        return np.where(at < PARTS, JUDGED, self._prices[at])

    def affordable(self, price: float) -> float:
        """Returns the greatest budget whose list takes at most a time [s]."""
        return self._unit * max(int(np.searchsorted(self._prices, price, side="right")) - 1, PARTS)


class CostToGo:
    """The cost to go along one trajectory: thresholds from distances at first, and labels after `sweep`.

    Attributes:
        chain, places: arm and points for kernels.
        labels: see Labels.
        least: a lower bound of the cost to go of all configurations with exit k, shape (n,).
        neighbours: one for each thread.
    """

    def __init__(self, points: TrajectoryPoints, threads: int, most_labels: int, most_tips: int) -> None:
        solver, count = points.solver, len(points)
        self.chain = chain_of(solver.manipulator, solver.weights, solver.least_weight, solver.whole_weights)
        self.places, self._solver, self._most_tips = places_of(points, self.chain), solver, most_tips
        memory, none = (np.empty(most_labels, np.int64), np.empty(most_labels)), np.zeros(count, np.int64)
        self.labels = Labels(*memory, none, none.copy(), np.zeros(count), farthest_exits(self.places))
        self.least, self._used, self._unit = np.zeros(count), 0, self.chain.least if self.chain.whole else 0.0
        self._level(count - 1)
        scenes = [scene_of(solver.manipulator, solver.clearance) for _ in range(threads)]
        self.neighbours = [Neighbours(self.chain, self.places, scene) for scene in scenes]
        self.prices = Prices(self.chain)
        self.tips: UpperTips | None = None
        self._counts = np.array([expected(solver, points[k].target) for k in range(count)])

    def _level(self, end: int) -> None:
        """Sets the thresholds of all points before `end` to what the distances of the points prove."""
        for k in range(end - 1, -1, -1):
            step = 0.0 if self.places.fixed[k + 1] else self.chain.least
            self.least[k] = self.labels.thresholds[k] = step + self.least[k + 1 : self.labels.last[k + 1] + 1].min()

    def judged(self, k: int, keys: Integers) -> tuple[Array, Integers]:
        """Returns lower bounds of the cost to go, and exits, of keys (n, words) at point k, see `judge`."""
        return self.neighbours[0].judged(self.labels, k, keys)

    def sweep(self, start: Integers, incumbent: float, seconds: float, late: Late) -> None:
        """Computes labels from the last point to the first.

        Args:
            start: key of the start (1, words).
            incumbent: cost of a plan; configurations that cannot be part of a cheaper one are left out.
            seconds: about how long it may take. The prices of the work decide; a slower computer lowers it further.
            late: whether to end at once; the labels of the points behind stay.
        """
        count = len(self.least)
        if self.chain.words[-1] > 0 or count == 1:
            return
        self._used, self.labels.begins[:], self.labels.ends[:] = 0, 0, 0
        near = self.chain.costs[np.arange(len(self.chain.states)), states_of(self.chain, start)[0]]
        most = int(min(self._most_tips, max(TIPS_PER_SECOND * seconds, FEWEST_TIPS)))
        self.tips = tips = upper_tips(self.chain, most, float(self.places.radii.min()))
        self.leaves = float(np.prod(self.chain.states[: tips.cut].astype(float)))
        threads, work, began = len(self.neighbours), seconds * len(self.neighbours), time.perf_counter()
        spent, limit = 0.0, 0.0
        for k in range(count - 2, -1, -1):
            taken = time.perf_counter() - began
            speed = min(spent / (threads * taken), 1.0) if spent > LEAST_SPENT else 0.7
            work = min(work, (seconds - taken) * threads * speed)
            if (count - 2 - k) % max(count // LIMITS, 1) == 0:
                limit = self._limit(k, work)
            step = Step(self, k, np.ascontiguousarray(near), incumbent, late)
            depth = step.depth(limit)
            while depth is not None and not step.run(depth):
                depth = depth - 1 if depth > SHALLOWEST and not late() else None
            work, spent = work - step.spent, spent + step.spent
            if depth is None:
                self._level(k + 1)
                return

    def _limit(self, k: int, work: float) -> float:
        """Returns the time of one step [s], so that all steps to the first point take about `work`.

        Each step gains about as much by the next depth: so the cheapest are taken.
        """
        counts = self._counts[1 : k + 2]
        times = self.leaves * LEAF + counts[:, None] * self.prices.of(self.chain.least * np.arange(1.0, DEEPEST_STEP))
        limits = np.sort(times.ravel())
        low, high = 0, len(limits)
        while low < high:
            middle = (low + high) // 2
            if np.where(times <= limits[middle], times, 0.0).max(axis=1).sum() <= work:
                low = middle + 1
            else:
                high = middle
        return float(limits[low - 1]) if low else work / (k + 1)


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


class Step:
    """The step from the configurations that serve point k + 1 to labels of those with exit k."""

    def __init__(self, to_go: CostToGo, k: int, near: Array, incumbent: float, late: Late) -> None:
        self._to_go, self._k, self._near, self._incumbent, self._late = to_go, k, near, incumbent, late
        self.spent = 0.0  # [s], see PRICE
        labels, self._far = to_go.labels, int(to_go.labels.last[k + 1])
        exits = range(k + 1, self._far + 1)
        self._base = float(labels.thresholds[self._far])
        self._values = np.concatenate([labels.values[labels.begins[e] : labels.ends[e]] for e in exits])
        self._least = float(to_go.least[k + 1 : self._far + 1].min())
        self._fixed = bool(to_go.places.fixed[k + 1])

    def depth(self, limit: float) -> int | None:
        """Returns how many least weights the threshold rises over that of the farthest exit within a time [s]."""
        for depth in range(DEEPEST_STEP, SHALLOWEST - 1, -1):
            if self._expected(depth) <= limit:
                return depth
        return None

    def _target(self, depth: int) -> float:
        return self._base + depth * self._to_go.chain.least

    def _most(self, depth: int) -> float:
        """Returns the most that a label to be found may have."""
        return self._target(depth) - self._to_go._unit

    def _budget(self, depth: int) -> float:
        """Returns the greatest budget of a configuration without a label."""
        return self._most(depth) - self._base

    def _expected(self, depth: int) -> float:
        to_go = self._to_go
        time = float(to_go.prices.of(self._most(depth) - self._values).sum())
        if self._enumerates(depth):
            thresholds = to_go.labels.thresholds[self._k + 1 : self._far + 1]
            shares = self._shares()
            time += to_go.leaves * LEAF if to_go.leaves <= MOST_LEAVES else np.inf
            count = to_go._counts[self._k + 1]
            time += count * float((shares * to_go.prices.of(self._most(depth) - thresholds)).sum())
        return time

    def _enumerates(self, depth: int) -> bool:
        """Returns whether configurations without labels must be listed."""
        return self._fixed or self._budget(depth) >= self._to_go.chain.least * (1 - EPSILON)

    def _shares(self) -> Array:
        """Returns which share of the configurations that serve the next point has which exit, about."""
        k, places, far = self._k + 1, self._to_go.places, self._far
        if far == k:
            return np.ones(1)
        size = 2 if self._to_go.chain.motions.shape[1] == 4 else 3
        rng = np.random.default_rng(0)
        points = rng.uniform(-1, 1, (SAMPLES, size))
        points = points[(points**2).sum(axis=1) <= 1] * places.radii[k] + places.positions[k, :size]
        away = np.linalg.norm(points[:, None] - places.positions[k : far + 1, :size], axis=2)
        served = np.logical_and.accumulate(away <= places.radii[k : far + 1], axis=1).sum(axis=1)
        return np.bincount(np.maximum(served, 1) - 1, minlength=far - k + 1) / len(points)

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
        most = min(LABELS_OF_POINT, len(labels.keys) - to_go._used)
        if len(keys) > most:
            threshold = float(np.partition(values, most)[most])
            keys, values = keys[values < threshold], values[values < threshold]
        begin = to_go._used
        to_go._used = end = begin + len(keys)
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
            self.spent += to_go.leaves * LEAF
            return walks(to_go.chain, to_go.tips, self._near)
        keys = [labels.keys[labels.begins[e] : labels.ends[e]] for e in range(k, self._far + 1)]
        own = np.concatenate(keys)[self._most(depth) - self._values >= to_go.chain.least * (1 - EPSILON)]
        return np.array_split(own[:, None], max(len(own) // SHARE, 1))

    def _keys(self, part: Walk | Integers) -> Iterator[Integers]:
        """Yields the keys (n, 1) of a part."""
        tips = self._to_go.tips
        if not isinstance(part, Walk) or tips is None:
            yield part  # type: ignore[misc]
            return
        to_go, k, found = self._to_go, self._k + 1, np.empty(SHARE, np.int64)
        reach, limit = reaches(to_go.chain), (self._incumbent - self._to_go._unit - self._least) * (1 + EPSILON)
        position, radius = to_go.places.positions[k], float(to_go.places.radii[k])
        while (count := list_serving(to_go.chain, tips, part, reach, self._near, limit, position, radius, found)) != 0:
            if count < 0:
                found = np.empty(4 * len(found), np.int64)
                continue
            yield found[:count, None].copy()

    def _found(self, neighbours: Neighbours, keys: Integers, depth: int) -> tuple[Integers, Array] | None:
        """Returns keys and values of labels of point k that are near keys (n, 1) which serve point k + 1."""
        to_go, k = self._to_go, self._k
        rest, _ = neighbours.judged(to_go.labels, k + 1, keys)
        budgets = self._most(depth) - rest
        use = np.flatnonzero(budgets >= (0.0 if self._fixed else to_go.chain.least * (1 - EPSILON)))
        self.spent += float(to_go.prices.of(budgets).sum())
        if self.spent > self._allowed:
            return None
        found = neighbours.near(k, keys[use], budgets[use], MOST_FOUND, self._late)
        if found is None:
            return None
        near, values = found.keys, rest[use][found.sources] + found.costs
        if to_go.labels.last[k] > k:
            _, exits = neighbours.judged(to_go.labels, k, near)
            keep = exits == k
            near, values = near[keep], values[keep]
        states = states_of(to_go.chain, near)
        from_start = self._near[np.arange(states.shape[1]), states].sum(axis=1)
        keep = (from_start + values < self._incumbent * (1 - EPSILON)) & (values < self._target(depth) * (1 - EPSILON))
        near, values = near[keep], values[keep]
        chosen = cheapest(near, values)
        return near[chosen], values[chosen]
