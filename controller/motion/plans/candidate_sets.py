"""Complete candidate sets: all configurations within the tolerances of a goal that cost little from given sources."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import boolean, float64, int32, int64, njit, types, uint16
from numpy.typing import NDArray

from controller.manipulator.kernel_types import F1, F2, F3, I1, named
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.scene import Scene, collides, for_scenes
from controller.search.frame_rows import compose, motions
from controller.search.segment import ROWS, Rows, Sets, grow, room
from controller.search.target import QUERY, SearchQuery, SearchTarget, reaches
from controller.search.two_list import middle

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Index32 = NDArray[np.int32]
States = NDArray[np.uint16]

FEWEST_ROWS, MOST_ROWS = 1 << 10, 1 << 18  # least and greatest memory of a half: changes within half a budget
CELL = 2.000001  # width of a cell in search radii: rounding must not put near points more than one cell apart
ROUNDING = 1e-9  # relative rounding error of sums of weights
AT_ONCE = 32  # sources between two checks of the deadline


class Changes(NamedTuple):
    """The costs of switches, and the arm cut in two.

    Attributes:
        motions: see frame_rows, shape (B * Kmax, 4) or (B * Kmax, 12).
        states: K_i, shape (B,).
        costs: cost of each module's states from each other, shape (B, Kmax, Kmax).
        cut: number of modules in the lower half.
    """

    motions: Array
    states: Integers
    costs: Array
    cut: int


class CandidateList(NamedTuple):
    """Configurations within the tolerances.

    Attributes:
        sources: number of the source from which each was found, shape (n,).
        configurations: shape (n, B).
    """

    sources: Integers
    configurations: States


I32, STATES = int32[:, ::1], uint16[:, ::1]
CHANGES = named(Changes, F2, I1, F3, int64)
CANDIDATES = named(CandidateList, I1, STATES)
COUNTS: Any = types.UniTuple(int64, 3)  # type: ignore[no-untyped-call]


@njit(types.void(F2, int64, boolean, F1, F2, int64), cache=True, nogil=True, inline="always")
def matching_point(frames: Array, n: int, lower: bool, goal: Array, points: Array, k: int) -> None:
    """Writes to points[k] the goal (3,) in frames[n] of the lower half, or the position of frames[n] of the upper."""
    planar = frames.shape[1] == 4
    if not lower:
        points[k, 0], points[k, 1] = frames[n, 0], frames[n, 1]
        points[k, 2] = 0.0 if planar else frames[n, 2]
    elif planar:
        x, y, c, s = goal[0] - frames[n, 0], goal[1] - frames[n, 1], frames[n, 2], frames[n, 3]
        points[k, 0], points[k, 1], points[k, 2] = c * x + s * y, c * y - s * x, 0.0
    else:
        x, y, z = goal[0] - frames[n, 0], goal[1] - frames[n, 1], goal[2] - frames[n, 2]
        for a in range(3):
            points[k, a] = frames[n, 3 + a] * x + frames[n, 6 + a] * y + frames[n, 9 + a] * z


@njit("i8(i8, i8, i8)", cache=True, nogil=True, inline="always")
def hash_of(i: int, j: int, k: int) -> int:
    """Returns a hash of a cell's coordinates, at least 0."""
    return (i * 73856093 ^ j * 19349663 ^ k * 83492791) & 0x7FFFFFFF


@njit(types.void(ROWS, int64, I1), cache=True, nogil=True)
def write_changes(rows: Rows, n: int, configuration: Configuration) -> None:
    """Writes the states of a row to a configuration (B,) that has the states of the seed."""
    row = n
    while row > 0:
        configuration[rows.modules[row]] = rows.choices[row]
        row = rows.parents[row]


class Half(NamedTuple):
    """Changes of one half of the arm, in hashed cells by their matching points.

    Attributes:
        rows: the changes; row 0 is the seed.
        points: matching points, shape (n, 3).
        cells: cells of the points, shape (n, 3).
        heads: first change of each hash slot, -1 for none; the number of slots is a power of two.
        following: next change in the same slot, -1 for none, shape (n,).
        least: least cost of a change.
    """

    rows: Rows
    points: Array
    cells: Index32
    heads: Index32
    following: Index32
    least: float


HALF = named(Half, ROWS, F2, I32, int32[::1], int32[::1], float64)


@njit(
    for_scenes(
        lambda scene: int64(CHANGES, QUERY, scene, I1, F2, float64, float64, boolean, F1, HALF, int64, CANDIDATES)
    ),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def match(
    changes: Changes,
    query: SearchQuery,
    scene: Scene | None,
    seed: Configuration,
    near: Array,
    budget: float,
    above: float,
    lower: bool,
    goal: Array,
    half: Half,
    count: int,
    listed: CandidateList,
) -> int:
    """Matches all changes of one half with the other half; returns the number of configurations listed, -1 if full.

    Args:
        changes: the arm.
        query: the goal.
        scene: obstacles.
        seed: configuration, shape (B,).
        near: costs of all states from the seed, shape (B, Kmax).
        budget: greatest cost of both changes together.
        above: the changes of this half must cost more.
        lower: whether this half is the lower one.
        goal: position in frame F_0, shape (3,).
        half: the other half.
        count: number of configurations listed before.
        listed: written, without the sources.
    """
    moves, states, _, cut = changes
    modules, kinds, width = len(seed), near.shape[1], moves.shape[1]
    first, size = (0, cut) if lower else (cut, modules - cut)
    if size == 0:  # the upper half of an arm of one module has no changes
        return count
    planar = width == 4
    per, farthest = 1.0 / (CELL * query.radius), query.radius * query.radius
    points, cells, heads, following, spent = half.points, half.cells, half.heads, half.following, half.rows.lengths
    slots = len(heads) - 1
    # Frames from the half's bottom to each of its modules, and from each module to the half's end at the seed.
    frames, rest = np.zeros((size + 2, width)), np.zeros((size + 1, width))
    for a in range(2 if planar else 3, width, 2 if planar else 4):
        frames[0, a] = rest[size, a] = 1.0
    least, costs = np.full(size + 1, np.inf), np.zeros(size + 1)
    for d in range(size - 1, -1, -1):
        i = first + d
        compose(moves, i * kinds + seed[i], rest, d + 1, rest, d)
        least[d] = least[d + 1]
        for j in range(states[i]):
            if j != seed[i]:
                least[d] = min(least[d], near[i, j])
    chosen, candidate, point, d = np.full(size, -1), np.empty(modules, np.int64), np.zeros((1, 3)), 0
    while d >= 0:
        chosen[d] += 1
        i, j = first + d, chosen[d]
        if j == states[i]:
            d -= 1
            continue
        cost = costs[d] + near[i, j]
        if cost > budget:
            continue
        compose(frames, d, moves, i * kinds + j, frames, d + 1)
        if d + 1 < size and cost + least[d + 1] <= budget:
            d += 1
            costs[d], chosen[d] = cost, -1
            continue
        if cost <= above:
            continue
        compose(frames, d + 1, rest, d + 1, frames, size + 1)
        matching_point(frames, size + 1, lower, goal, point, 0)
        remaining, x, y, z = budget - cost, point[0, 0], point[0, 1], point[0, 2]
        square = (x - points[0, 0]) ** 2 + (y - points[0, 1]) ** 2 + (z - points[0, 2]) ** 2
        if remaining < half.least and square > farthest:
            continue
        x0, y0 = int(np.floor(x * per - 0.5)), int(np.floor(y * per - 0.5))
        z0 = 0 if planar else int(np.floor(z * per - 0.5))
        for corner in range(4 if planar else 8):
            u, v, w = x0 + (corner & 1), y0 + ((corner >> 1) & 1), z0 + (corner >> 2)
            n = heads[hash_of(u, v, w) & slots]
            while n >= 0:
                row, n = n, following[n]
                if spent[row] > remaining or cells[row, 0] != u or cells[row, 1] != v or cells[row, 2] != w:
                    continue
                square = (x - points[row, 0]) ** 2 + (y - points[row, 1]) ** 2 + (z - points[row, 2]) ** 2
                if square > farthest:
                    continue
                for a in range(modules):
                    candidate[a] = chosen[a - first] if first <= a <= first + d else seed[a]
                write_changes(half.rows, row, candidate)
                if not reaches(query, candidate):
                    continue
                if scene is not None and collides(scene, candidate):
                    continue
                if count == len(listed.sources):
                    return -1
                for a in range(modules):
                    listed.configurations[count, a] = candidate[a]
                count += 1
    return count


@njit(
    for_scenes(lambda scene: COUNTS(CHANGES, QUERY, scene, F1, STATES, F1, ROWS, ROWS, CANDIDATES)),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def list_candidates(
    changes: Changes,
    query: SearchQuery,
    scene: Scene | None,
    goal: Array,
    sources: States,
    budgets: Array,
    lower: Rows,
    upper: Rows,
    listed: CandidateList,
) -> tuple[int, int, int]:
    """Lists the clear configurations within the tolerances that cost at most a budget from each source.

    Returns the number of listed configurations; the number of sources that are done; and what has no room: rows (1),
    configurations (2), or nothing (0).

    The arm is cut in two (meet in the middle). The changes of one half that cost at most half the budget are put into
    cells by their matching points: the tip in frame F_cut for the upper half, the goal in frame F_cut for the lower.
    All changes of the other half are looked up in these cells; then the halves swap roles.

    Args:
        changes: the arm.
        query: the goal.
        scene: obstacles.
        goal: position in frame F_0, shape (3,).
        sources: configurations, shape (n, B).
        budgets: greatest cost from each source, shape (n,).
        lower: memory for changes of the lower half.
        upper: memory of the same size for the upper half.
        listed: written.
    """
    moves, states, prices, cut = changes
    modules, most_rows, per = sources.shape[1], len(lower.costs), 1.0 / (CELL * query.radius)
    points, cells = np.zeros((most_rows, 3)), np.empty((most_rows, 3), np.int32)
    following, heads, count = np.empty(most_rows, np.int32), np.empty(1, np.int32), 0
    near, seed = np.zeros(prices.shape[:2]), np.empty(modules, np.int64)
    for n in range(len(sources)):
        begun, budget = count, budgets[n] * (1 + ROUNDING)
        for i in range(modules):
            seed[i] = sources[n, i]
            for j in range(prices.shape[1]):
                near[i, j] = prices[i, seed[i], j]
        sets = Sets(moves, states, seed, near, near)
        for of_lower in (False, True):
            rows, start, end = (lower, 0, cut) if of_lower else (upper, cut, modules)
            known, _ = grow(sets, start, end, budget / 2, most_rows, rows)
            if known == most_rows:
                return begun, n, 1
            slots = 64
            while slots < 2 * known:
                slots *= 2
            if slots != len(heads):
                heads = np.empty(slots, np.int32)
            heads[:] = -1
            least = np.inf
            for row in range(known):
                matching_point(rows.frames, row, of_lower, goal, points, row)
                for a in range(3):
                    cells[row, a] = int(np.floor(points[row, a] * per))
                slot = hash_of(cells[row, 0], cells[row, 1], cells[row, 2]) & (slots - 1)
                following[row], heads[slot] = heads[slot], row
                if row > 0:
                    least = min(least, rows.lengths[row])
            half = Half(rows, points, cells, heads, following, least)
            above = budget / 2 if of_lower else -1.0
            count = match(changes, query, scene, seed, near, budget, above, not of_lower, goal, half, count, listed)
            if count < 0:
                return begun, n, 2
        for k in range(begun, count):
            listed.sources[k] = n
    return count, len(sources), 0


class CandidateSets:
    """Lists complete candidate sets of one arm; holds the memory for them.

    Args:
        manipulator: the arm.
        weights: of the actuators' switches, see Manipulator.per_module, shape (B, Amax).
    """

    def __init__(self, manipulator: Manipulator, weights: Array) -> None:
        bits = manipulator.bits
        costs = ((bits[:, :, None] != bits[:, None]) * weights[:, None, None]).sum(axis=3, dtype=float)
        cut = max(middle(manipulator, 0, len(manipulator.modules)), 1)
        moves = motions(manipulator)
        self._changes = Changes(moves, manipulator.states, np.ascontiguousarray(costs), cut)
        self._lower, self._upper = (room(FEWEST_ROWS, moves.shape[1]) for _ in range(2))

    def find(
        self,
        target: SearchTarget,
        sources: States,
        budgets: Array,
        most: int,
        late: Callable[[], bool],
    ) -> CandidateList | None:
        """Returns all clear configurations within the tolerances that cost at most a budget from a source.

        Returns None if they are more than `most`, if `late()` becomes true, or if a half has too many changes.

        Args:
            target: the goal.
            sources: configurations, shape (n, B).
            budgets: greatest cost from each source, shape (n,).
            most: greatest number of configurations.
            late: whether the deadline has passed.
        """
        listed = CandidateList(np.empty(most, np.int64), np.empty((most, sources.shape[1]), np.uint16))
        first = count = 0
        while first < len(sources):
            part, free = (
                slice(first, first + AT_ONCE),
                CandidateList(listed.sources[count:], listed.configurations[count:]),
            )
            given = self._changes, target.query, target.scene, target.position, sources[part], budgets[part]
            more, done, lacks = list_candidates(*given, self._lower, self._upper, free)
            free.sources[:more] += first
            first, count = first + done, count + more
            if lacks == 2 or (lacks == 1 and len(self._lower.costs) >= MOST_ROWS) or late():
                return None
            if lacks == 1:
                rows, width = self._lower.frames.shape
                self._lower, self._upper = room(4 * rows, width), room(4 * rows, width)
        return CandidateList(listed.sources[:count], listed.configurations[:count])
