"""All pairs of two lists of configurations that differ by little.

If two configurations differ by a cost of at most c, their lowest or their highest modules differ by at most c / 2
(pigeonhole principle). One list is sorted by its lowest modules, and by its highest. Small changes of the lowest, or of
the highest, modules of the other list's configurations are looked up there.
"""

from typing import NamedTuple

import numpy as np
from numba import int64
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, S1, UNCOUNTED, named
from hyperbit.controller.search.neighbours.chain import Chain

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Index32 = NDArray[np.int32]

MOST_BITS, TABLE_BITS = 24, 12  # of a group; of a table of costs


class Groups(NamedTuple):
    """Keys sorted by the states of some modules in a row, the lowest or the highest ones."""

    keys: Integers  # shape (n,)
    starts: Index32  # first key of each group, shape (groups + 1,)
    shift: int  # lowest bit of the modules
    mask: int  # of their bits, after the shift
    first: int  # these modules
    last: int


class Changes(NamedTuple):
    """Changes of the modules of groups, the cheapest first."""

    bits: Integers  # that differ in a key, shape (n,)
    costs: Array  # shape (n,)


GROUPS, CHANGES = named(Groups, I1, S1, int64, int64, int64, int64), named(Changes, I1, F1)


def by_bits(chain: Chain) -> bool:
    """Returns whether keys have one word, and the bits in which they differ determine the cost between them."""
    states = chain.costs.shape[1]
    differ = np.arange(states)[:, None] ^ np.arange(states)
    pairs = zip(chain.costs, chain.states.tolist(), strict=True)
    return (
        len(chain.states) > 1
        and chain.words[-1] == 0
        and all(k & (k - 1) == 0 and np.allclose(own[:k, :k], own[0][differ[:k, :k]]) for own, k in pairs)
    )


def groups(chain: Chain, keys: Integers) -> tuple[Groups, Groups]:
    """Returns keys (n,) by their lowest, and by their highest, modules."""
    ends = np.append(chain.shifts, chain.shifts[-1] + int(chain.masks[-1]).bit_length())
    modules, bits, total = len(chain.states), min(len(keys).bit_length() + 2, MOST_BITS), int(ends[-1])
    middle = min(max(int(np.searchsorted(ends, total / 2)), 1), modules - 1)
    last = min(max(int(np.searchsorted(ends, bits, side="right")) - 1, 1), middle)
    first = max(min(int(np.searchsorted(ends, total - bits)), modules - 1), middle)
    result = list[Groups]()
    for low, high in ((0, last), (first, modules)):
        shift, width = int(ends[low]), int(ends[high] - ends[low])
        mask, rest = (1 << width) - 1, total - width
        if low == 0:  # the bits of the lowest modules come first, so that one sort does it
            turned = np.sort(((keys & mask) << rest) | (keys >> width))
            ordered = ((turned & ((1 << rest) - 1)) << width) | (turned >> rest)
        else:
            ordered = np.sort(keys)
        starts = np.zeros(mask + 2, np.int32)
        np.cumsum(np.bincount((ordered >> shift) & mask, minlength=mask + 1), dtype=np.int32, out=starts[1:])
        result.append(Groups(ordered, starts, shift, mask, low, high))
    return result[0], result[1]


def changes(chain: Chain, group: Groups, most: float) -> Changes:
    """Returns all changes of the modules of a group that cost at most so much."""
    bits, costs = np.zeros(1, np.int64), np.zeros(1)
    for i in range(group.first, group.last):
        own, states = chain.costs[i, 0, : chain.states[i]], np.arange(chain.states[i]) << chain.shifts[i]
        sums = costs[:, None] + own
        few = sums <= most
        bits, costs = (bits[:, None] ^ states)[few], sums[few]
    order = np.argsort(costs, kind="stable")
    return Changes(bits[order], costs[order])


class Tables(NamedTuple):
    """Costs of all differences of a few modules in a row."""

    costs: Array  # shape (parts, most differences)
    shifts: Integers  # lowest bit of each part, shape (parts,)
    masks: Integers  # shape (parts,)


TABLES = named(Tables, F2, I1, I1)


def tables_of(chain: Chain) -> Tables:
    """Returns the costs of differences of up to TABLE_BITS bits, or of one module."""
    parts, used = [[0]], 0
    for i in range(1, len(chain.states)):
        used = int(chain.shifts[i] - chain.shifts[parts[-1][0]]) + int(chain.masks[i]).bit_length()
        if used > TABLE_BITS:
            parts.append([])
        parts[-1].append(i)
    shifts = np.array([chain.shifts[part[0]] for part in parts])
    masks = np.array([sum(int(chain.masks[i]) << int(chain.shifts[i]) for i in part) for part in parts]) >> shifts
    differ = np.arange(int(masks.max()) + 1)
    costs = np.zeros((len(parts), len(differ)))
    for row, part, low in zip(costs, parts, shifts, strict=True):
        for i in part:
            row += chain.costs[i, 0][(differ >> (chain.shifts[i] - low)) & chain.masks[i]]
    return Tables(costs, shifts, masks)


@kernel(int64(TABLES, GROUPS, CHANGES, I1, F1, I1, I1, I1, F1), **UNCOUNTED)
def join(
    tables: Tables,
    group: Groups,
    few: Changes,
    keys: Integers,
    budgets: Array,
    done: Integers,
    sources: Integers,
    found: Integers,
    costs: Array,
) -> int:
    """Lists keys of a group that cost at most a budget (n,) from keys (n,), by changes of the group's modules.

    Returns how many of `sources`, `found` and `costs` (m,) are written: all pairs of the keys from done[0] on up to the
    new done[0].
    """
    count, parts, up = 0, len(tables.shifts), group.shift == 0
    for n in range(done[0], len(keys)):
        begun, key, budget = count, keys[n], budgets[n]
        for c in range(len(few.bits)):
            if few.costs[c] > budget:
                break
            at = ((key ^ few.bits[c]) >> group.shift) & group.mask
            for m in range(group.starts[at], group.starts[at + 1]):
                differ, cost = key ^ group.keys[m], 0.0
                for i in range(parts):  # the other modules first: they differ most
                    part = parts - 1 - i if up else i
                    cost += tables.costs[part, (differ >> tables.shifts[part]) & tables.masks[part]]
                    if cost > budget:
                        break
                if cost > budget:
                    continue
                if count == len(found):
                    done[0] = n
                    return begun
                sources[count], found[count], costs[count] = n, group.keys[m], cost
                count += 1
    done[0] = len(keys)
    return count


class Pairing:
    """Finds the pairs of one list of keys (n,) with others, up to a cost `most`."""

    def __init__(self, chain: Chain, keys: Integers, most: float) -> None:
        limits = (most / 2, (most - chain.least) / 2 if chain.whole else most / 2)
        self._tables, slack, parts = tables_of(chain), chain.least * 1e-6, groups(chain, keys)
        self._parts = [(part, changes(chain, part, limit + slack)) for part, limit in zip(parts, limits, strict=True)]

    def near(self, keys: Integers, budgets: Array) -> tuple[Integers, Integers, Array]:
        """Returns sources, keys and costs of all pairs within budgets (n,) of keys (n,). Pairs may come twice."""
        results, size = list[tuple[Integers, Integers, Array]](), 2 * len(keys) + 64
        for group, few in self._parts:
            done = np.zeros(1, np.int64)
            while True:
                memory = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size)
                count = join(self._tables, group, few, keys, budgets, done, *memory)
                results.append((memory[0][:count], memory[1][:count], memory[2][:count]))
                if done[0] == len(keys):
                    break
                size *= 4 if count == 0 else 1
        sources, found, costs = (np.concatenate(arrays) for arrays in zip(*results, strict=True))
        return sources, found, costs
