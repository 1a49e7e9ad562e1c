"""Labels: lower bounds of the cost to go."""

from typing import NamedTuple

import numpy as np
from numba import int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, I1, I2, UNCOUNTED, named
from hyperbit.controller.obstacles.scene import Scene, for_scenes
from hyperbit.controller.search.neighbours.chain import CHAIN, PLACES, Chain, Places, fits, serves, state_of, write_tip
from hyperbit.controller.search.neighbours.changes import CHANGED, Changed
from hyperbit.controller.search.neighbours.neighbours import Neighbours, Pairs

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Labels(NamedTuple):
    """Lower bounds of the cost to go of configurations with exit k: labels, and the threshold of all others."""

    keys: Integers  # of all labels, those of each point sorted, shape (m,)
    values: Array  # shape (m,)
    begins: Integers  # first label of each point, shape (n,)
    ends: Integers  # shape (n,)
    thresholds: Array  # shape (n,)
    last: Integers  # farthest exit of a configuration that serves each point, shape (n,)

    def of(self, k: int) -> slice:
        """Returns the labels of all configurations that serve point k; those of the last points come first."""
        last = int(self.last[k])
        return slice(int(self.begins[last]), int(self.ends[k : last + 1].max()))


class Layer(NamedTuple):
    """Configurations that serve a point."""

    keys: Integers  # shape (n, words)
    costs: Array  # of the cheapest sequence to each, shape (n,)
    before: Integers  # index of the predecessor in the layer before, shape (n,)
    rest: Array  # lower bound of the cost to go, shape (n,)
    exits: Integers  # shape (n,)

    def of(self, rows: Integers) -> "Layer":
        return Layer(*(array[rows] for array in self))  # type: ignore[arg-type]


LABELS = named(Labels, I1, F1, I1, I1, F1, I1)


@kernel(
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
        exit, tip = k, write_tip(chain, keys, n, changed.frames)
        while exit < labels.last[k] and serves(chain, places, exit + 1, changed.frames, tip, keys, n):
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


def judged(neighbours: Neighbours, labels: Labels, k: int, keys: Integers) -> tuple[Array, Integers]:
    """Returns lower bounds of the cost to go, and exits, of keys (n, words) at point k, see `judge`."""
    rest, exits = np.empty(len(keys)), np.empty(len(keys), np.int64)
    judge(neighbours.chain, neighbours.places, labels, neighbours.scene, k, keys, neighbours.changed, rest, exits)
    return rest, exits


@kernel(int64(CHAIN, I2, F1, I1, F1, I1, I1, F1), **UNCOUNTED)
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


def near_labels(chain: Chain, keys: Integers, rooms: Array, labels: Integers, values: Array) -> Pairs:
    """Returns all pairs of keys (n, 1) and labels (m,) within the keys' rooms (n,), see `scan`."""
    size = 1 << 16
    while True:
        sources, targets, costs = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size)
        if (count := scan(chain, keys, rooms, labels, values, sources, targets, costs)) >= 0:
            return Pairs(sources[:count], targets[:count, None], costs[:count])
        size *= 4


def cheapest(keys: Integers, values: Array) -> Integers:
    """Returns the rows of the least value of each key (n, words), in the order of the keys."""
    order = np.lexsort((values, *keys.T[::-1]))
    ordered = keys[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order[new]
