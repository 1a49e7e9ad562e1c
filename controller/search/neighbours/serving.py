"""All configurations whose tips are near a position: those of the lower modules are tried one after the other.

The tips of all configurations of the upper modules are sorted into cells once. For each configuration of the lower
modules the position, as seen from their top, is looked up in these cells.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numba import boolean, float32, float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, UNCOUNTED, named
from hyperbit.controller.search.lists.segment import compose
from hyperbit.controller.search.neighbours.chain import CHAIN, Chain, moved_back

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]

LISTED = 1 << 14  # keys that are listed at once
TURN = 1 << 22  # points compared until the caller gets a turn: about 10 ms
SPLIT = 2  # lowest modules whose states divide the configurations into parts, for threads


class UpperTips(NamedTuple):
    """Tips of the modules above a cut, sorted into cells."""

    points: Singles  # in frame F_cut, shape (3, n)
    keys: Integers  # see Chain, shape (n,)
    starts: Integers  # first point of each cell, cells along x one after the other, shape (cells + 1,)
    least: Array  # least corner of all cells, shape (3,)
    counts: Integers  # number of cells along x, y, z, shape (3,)
    cell: float  # width of a cell
    cut: int  # number of modules below


class Walk(NamedTuple):
    """How far one part of the configurations of the lower modules has been tried."""

    chosen: Integers  # state of each lower module, shape (cut,)
    frames: Array  # top of each lower module, shape (cut + 1, 4 or 12)
    keys: Integers  # states of the modules up to each, shape (cut + 1,)
    costs: Array  # from a given configuration, shape (cut + 1,)
    at: Integers  # the module whose states are tried; below the first when the walk is over, shape (1,)


UPPER_TIPS = named(UpperTips, float32[:, ::1], I1, I1, F1, I1, float64, int64)
WALK = named(Walk, I1, F2, I1, F1, I1)


def upper_tips(chain: Chain, most: int, radius: float) -> UpperTips:
    """Returns the tips of as many upper modules as have at most `most` configurations, for searches of some radius."""
    modules, dimension = len(chain.states), 2 if chain.motions.shape[1] == 4 else 3
    sizes = np.append(np.cumsum(np.log2(chain.states[::-1]))[::-1], 0.0)
    cut = max(int(np.argmax(sizes <= np.log2(most) + 1e-9)), 1)
    count = round(2.0 ** sizes[cut])
    reach = reaches(chain)[cut] + chain.blur + radius
    cell = max(radius, 2 * reach / (2 * count + 64) ** (1 / dimension))
    along = int(np.ceil(2 * reach / cell)) + 1
    counts, least = np.full(3, along), np.full(3, -reach)
    counts[dimension:], least[dimension:] = 1, 0.0
    memory = np.zeros((3, count), np.float32), np.zeros(count, np.int64), np.zeros(int(np.prod(counts)) + 1, np.int64)
    tips = UpperTips(*memory, least, counts, cell, cut)
    if cut == modules:
        tips.starts[cell_of(tips, 0.0, 0.0, 0.0) + 1 :] = 1
        return tips
    frames, chosen = np.zeros((modules - cut + 1, chain.motions.shape[1])), np.zeros(modules, np.int64)
    identity(frames)
    fill(chain, tips, frames, chosen, False)
    ends = np.cumsum(tips.starts)
    tips.starts[0], tips.starts[1:] = 0, ends[:-1]
    fill(chain, tips, frames, chosen, True)  # each start moves to the end of its cell
    tips.starts[0], tips.starts[1:] = 0, ends[:-1]
    return tips


def reaches(chain: Chain) -> Array:
    """Returns an upper bound of the distance from the top of the first i modules to the tip, shape (B + 1,)."""
    steps = np.linalg.norm(chain.motions[:, : 2 if chain.motions.shape[1] == 4 else 3], axis=1)
    longest = steps.reshape(len(chain.states), -1).max(axis=1)
    return np.append(np.cumsum(longest[::-1])[::-1], 0.0)


def identity(frames: Array) -> None:
    """Writes the frame without motion to the first row."""
    planar = frames.shape[1] == 4
    frames[0, 2 if planar else 3 :: 2 if planar else 4] = 1.0


@kernel(int64(UPPER_TIPS, float64, float64, float64), **UNCOUNTED, error_model="numpy", inline="always")
def cell_of(tips: UpperTips, x: float, y: float, z: float) -> int:
    """Returns the cell of a point."""
    i = int((x - tips.least[0]) / tips.cell)
    j = int((y - tips.least[1]) / tips.cell)
    k = int((z - tips.least[2]) / tips.cell)
    return int((k * tips.counts[1] + j) * tips.counts[0] + i)


@kernel(types.void(CHAIN, UPPER_TIPS, F2, I1, boolean), **UNCOUNTED, error_model="numpy")
def fill(chain: Chain, tips: UpperTips, frames: Array, chosen: Integers, write: bool) -> None:
    """Counts the tips of each cell in `starts`, or writes them at `starts`, which move on to the end of each cell."""
    first, modules, kinds, planar = tips.cut, len(chain.states), chain.costs.shape[1], frames.shape[1] == 4
    i, key = first, 0
    chosen[first] = -1
    while i >= first:
        chosen[i] += 1
        if chosen[i] == chain.states[i]:
            i -= 1
            continue
        compose(frames, i - first, chain.motions, i * kinds + chosen[i], frames, i + 1 - first)
        if i + 1 < modules:
            i += 1
            chosen[i] = -1
            continue
        row = i + 1 - first
        x, y, z = frames[row, 0], frames[row, 1], 0.0 if planar else frames[row, 2]
        cell = cell_of(tips, x, y, z)
        if write:
            at, key = tips.starts[cell], 0
            for m in range(first, modules):
                key |= chosen[m] << chain.shifts[m]
            tips.points[0, at], tips.points[1, at], tips.points[2, at], tips.keys[at] = x, y, z, key
        tips.starts[cell] += 1


def walks(chain: Chain, tips: UpperTips, near: Array) -> list[Walk]:
    """Returns a walk through each part of the configurations, by the costs of states (B, Kmax)."""
    width, kinds, result = chain.motions.shape[1], chain.costs.shape[1], list[Walk]()
    first = min(SPLIT, tips.cut - 1)
    for states in np.ndindex(*chain.states[:first]):
        size = tips.cut + 1
        walk = Walk(
            np.full(size, -1),
            np.zeros((size, width)),
            np.zeros(size, np.int64),
            np.zeros(size),
            np.zeros(1, np.int64) + first,
        )
        identity(walk.frames)
        for i, j in enumerate(states):
            compose(walk.frames, i, chain.motions, i * kinds + j, walk.frames, i + 1)
            walk.keys[i + 1], walk.costs[i + 1] = walk.keys[i] | (j << int(chain.shifts[i])), walk.costs[i] + near[i, j]
        result.append(walk)
    return result


@kernel(int64(CHAIN, UPPER_TIPS, WALK, F1, F2, float64, F1, float64, I1), **UNCOUNTED, error_model="numpy")
def list_serving(
    chain: Chain,
    tips: UpperTips,
    walk: Walk,
    reach: Array,
    near: Array,
    limit: float,
    position: Array,
    radius: float,
    found: Integers,
) -> int:
    """Lists the next configurations whose tips are near a position; returns their number, also 0 after a turn.

    Returns -1 if `found` is too small. The walk is over when `walk.at` is below its first module.

    Args:
        chain: the arm.
        tips: of its upper modules.
        walk: goes on.
        reach: see `reaches`.
        near: cost of each module's states, shape (B, Kmax).
        limit: greatest cost of a configuration.
        position: in F_0, shape (3,).
        radius: greatest distance, slightly more.
        found: written: keys, shape (n,).
    """
    chosen, frames, keys, costs, kinds = walk.chosen, walk.frames, walk.keys, walk.costs, chain.costs.shape[1]
    points, cut, modules, planar = tips.points, tips.cut, len(chain.states), frames.shape[1] == 4
    far, count, d, first = radius + chain.blur, 0, walk.at[0], min(SPLIT, cut - 1)
    square, compared = far * far, 0
    while d >= first and compared < TURN:
        compared += 1
        chosen[d] += 1
        if chosen[d] == chain.states[d]:
            chosen[d] = -1
            d -= 1
            continue
        costs[d + 1] = costs[d] + near[d, chosen[d]]
        if costs[d + 1] > limit:
            continue
        compose(frames, d, chain.motions, d * kinds + chosen[d], frames, d + 1)
        keys[d + 1] = keys[d] | (chosen[d] << chain.shifts[d])
        x, y, z = moved_back(frames, d + 1, position[0], position[1], position[2])
        if x * x + y * y + z * z > (reach[d + 1] + far) ** 2:
            continue
        if d + 1 < cut:
            d += 1
            continue
        begun = count
        lows, highs = tips.least, tips.counts
        i0, i1 = int((x - far - lows[0]) / tips.cell), int((x + far - lows[0]) / tips.cell)
        j0, j1 = int((y - far - lows[1]) / tips.cell), int((y + far - lows[1]) / tips.cell)
        k0, k1 = (0, 0) if planar else (int((z - far - lows[2]) / tips.cell), int((z + far - lows[2]) / tips.cell))
        i0, i1 = max(i0, 0), min(i1, highs[0] - 1)
        for k in range(max(k0, 0), min(k1, highs[2] - 1) + 1):
            for j in range(max(j0, 0), min(j1, highs[1] - 1) + 1):
                row = (k * highs[1] + j) * highs[0]
                begin, end = tips.starts[row + i0], tips.starts[row + i1 + 1] if i1 >= i0 else 0
                compared += max(end - begin, 0)
                for m in range(begin, end):
                    if (points[0, m] - x) ** 2 + (points[1, m] - y) ** 2 + (points[2, m] - z) ** 2 > square:
                        continue
                    if limit < np.inf:
                        cost = costs[cut]
                        for i in range(cut, modules):
                            cost += near[i, (tips.keys[m] >> chain.shifts[i]) & chain.masks[i]]
                        if cost > limit:
                            continue
                    if count == len(found):
                        chosen[d] -= 1
                        walk.at[0] = d
                        return begun if begun > 0 else -1
                    found[count] = keys[cut] | tips.keys[m]
                    count += 1
    walk.at[0] = d
    return count


def serving(
    chain: Chain, tips: UpperTips, walk: Walk, near: Array, limit: float, position: Array, radius: float
) -> Iterator[Integers]:
    """Yields keys (n,) of a walk whose tips are near a position, see `list_serving`; none of them after a turn without.

    Between two turns the caller may look at the time.
    """
    found, reach, first = np.empty(LISTED, np.int64), reaches(chain), min(SPLIT, tips.cut - 1)
    while walk.at[0] >= first:
        count = list_serving(chain, tips, walk, reach, near, limit, position, radius, found)
        if count < 0:
            found = np.empty(4 * len(found), np.int64)
        else:
            yield found[:count].copy()
