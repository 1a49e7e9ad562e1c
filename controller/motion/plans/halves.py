"""Configurations from changes of the two halves of an arm: changes in hashed cells, and their matches."""

from typing import NamedTuple

import numpy as np
from numba import boolean, float64, int32, int64, njit, types, uint16
from numpy.typing import NDArray

from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, I1, named
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.obstacles.scene import Scene, collides, for_scenes
from hyperbit.controller.search.segment import RANKED, ROWS, SETS, Ranked, Rows, Sets, compose
from hyperbit.controller.search.target import QUERY, SearchQuery, reaches

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Index32 = NDArray[np.int32]
States = NDArray[np.uint16]

CELL = 2.000001  # width of a cell in search radii: rounding must not put near points more than one cell apart


class Changes(NamedTuple):
    """The costs of switches, and the arm cut in two."""

    motions: Array  # see segment, shape (B * Kmax, 4) or (B * Kmax, 12)
    states: Integers  # K_i, shape (B,)
    costs: Array  # cost of each module's states from each other, shape (B, Kmax, Kmax)
    cut: int  # number of modules in the lower half


class Place(NamedTuple):
    """Where the tip must be."""

    query: SearchQuery  # goal and tolerances
    position: Array  # of the goal in frame F_0, shape (3,)


class CandidateList(NamedTuple):
    """Configurations within the tolerances."""

    sources: Integers  # number of the source from which each was found, shape (n,)
    configurations: States  # shape (n, B)
    written: Integers  # number of configurations that are written, shape (1,)


I2, I32, STATES = int64[:, ::1], int32[:, ::1], uint16[:, ::1]
CHANGES = named(Changes, F2, I1, F3, int64)
PLACE = named(Place, QUERY, F1)
CANDIDATES = named(CandidateList, I1, STATES, I1)


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


@njit("f8(f8[:,::1], f8[:,::1], i8)", cache=True, nogil=True, inline="always")
def square_between(point: Array, points: Array, k: int) -> float:
    """Returns the squared distance of a point (1, 4) from points[k] (n, 4); the last column does not count."""
    x, y, z = point[0, 0] - points[k, 0], point[0, 1] - points[k, 1], point[0, 2] - points[k, 2]
    return float(x**2 + y**2 + z**2)


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
    """Changes of one half of the arm, in hashed cells by their matching points."""

    lower: bool  # whether it is the lower half
    rows: Rows  # the changes; row 0 is the seed
    marks: Array  # matching point and cost of each change, shape (n, 4)
    links: Index32  # cell of each point, and the next change in the same hash slot, -1 for none, shape (n, 4)
    heads: NDArray[np.int32]  # first change of each hash slot, -1 for none; the number of slots is a power of two
    least: float  # least cost of a change


class CellMemory(NamedTuple):
    """Memory for the cells of a half; see Half. There are four times as many heads as changes."""

    marks: Array
    links: Index32
    heads: NDArray[np.int32]


HALF = named(Half, boolean, ROWS, F2, I32, int32[::1], float64)
CELL_MEMORY = named(CellMemory, F2, I32, int32[::1])


@njit([HALF(boolean, ROWS, int64, PLACE, CELL_MEMORY)], cache=True, nogil=True, error_model="numpy")
def index_half(lower: bool, rows: Rows, known: int, place: Place, memory: CellMemory) -> Half:
    """Puts the changes of a half into hashed cells.

    Args:
        lower: whether it is the lower half.
        rows: the changes.
        known: number of changes.
        place: the goal.
        memory: written.
    """
    slots, per, least = 64, 1.0 / (CELL * place.query.radius), np.inf
    while slots < 2 * known:
        slots *= 2
    marks, links, heads = memory.marks, memory.links, memory.heads[:slots]
    heads[:] = -1
    for row in range(known):
        matching_point(rows.frames, row, lower, place.position, marks, row)
        for a in range(3):
            links[row, a] = int(np.floor(marks[row, a] * per))
        slot = hash_of(links[row, 0], links[row, 1], links[row, 2]) & (slots - 1)
        marks[row, 3], links[row, 3], heads[slot] = rows.lengths[row], heads[slot], row
        if row > 0:
            least = min(least, rows.lengths[row])
    return Half(lower, rows, marks, links, heads, least)


@njit(int64(F2, I32, int32[::1], F2, float64, boolean, I1), cache=True, nogil=True, error_model="numpy")
def find_near(
    marks: Array, links: Index32, heads: NDArray[np.int32], point: Array, radius: float, planar: bool, found: Integers
) -> int:
    """Finds the changes of a half whose matching points are near a point; returns their number.

    Args:
        marks: see Half.
        links: see Half.
        heads: see Half.
        point: the point, and the greatest cost of a change, shape (1, 4).
        radius: greatest distance.
        planar: whether all points are in the plane z = 0.
        found: written: rows of the changes.
    """
    per, slots, count, most = 1.0 / (CELL * radius), len(heads) - 1, 0, point[0, 3]
    x0, y0 = int(np.floor(point[0, 0] * per - 0.5)), int(np.floor(point[0, 1] * per - 0.5))
    z0 = 0 if planar else int(np.floor(point[0, 2] * per - 0.5))
    for corner in range(4 if planar else 8):
        x, y, z = x0 + (corner & 1), y0 + ((corner >> 1) & 1), z0 + (corner >> 2)
        row = heads[hash_of(x, y, z) & slots]
        while row >= 0:
            same_cell = links[row, 0] == x and links[row, 1] == y and links[row, 2] == z
            if marks[row, 3] <= most and same_cell and square_between(point, marks, row) <= radius * radius:
                found[count] = row
                count += 1
            row = links[row, 3]
    return count


@njit(
    for_scenes(lambda scene: boolean(PLACE, scene, HALF, int64, I2, CANDIDATES)),
    cache=True,
    nogil=True,
)
def list_match(
    place: Place, scene: Scene | None, half: Half, row: int, changed: Integers, listed: CandidateList
) -> bool:
    """Lists the configuration of a change and one of the other half if it serves; returns False if there is no room.

    Args:
        place: the goal.
        scene: obstacles.
        half: the other half.
        row: change of the other half.
        changed: row 0: the seed with a change of this half; row 1: scratch; shape (2, B).
        listed: written, without the sources.
    """
    candidate, count = changed[1], listed.written[0]
    candidate[:] = changed[0]
    write_changes(half.rows, row, candidate)
    if not reaches(place.query, candidate):
        return True
    if scene is not None and collides(scene, candidate):
        return True
    if count == len(listed.sources):
        return False
    for a in range(len(candidate)):
        listed.configurations[count, a] = candidate[a]
    listed.written[0] += 1
    return True


@njit(
    for_scenes(lambda scene: boolean(SETS, RANKED, int64, float64, PLACE, scene, HALF, CANDIDATES)),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def match(
    sets: Sets,
    ranked: Ranked,
    first: int,
    budget: float,
    place: Place,
    scene: Scene | None,
    half: Half,
    listed: CandidateList,
) -> bool:
    """Matches all changes of one half of the arm with those of the other half; returns False if there is no room.

    The changes of the upper half cost more than half the budget: the others are found with the roles swapped.

    Args:
        sets: the arm, and the seed from which switches are counted.
        ranked: states of this half's modules.
        first: number of modules below this half.
        budget: greatest cost of the changes of both halves together.
        place: the goal.
        scene: obstacles.
        half: the other half.
        listed: written, without the sources.
    """
    # Arrays are taken out of tuples before the loops, which would count references for each change.
    (moves, states, seed, near, _), (lower, _, marks, links, heads, _) = sets, half
    goal, radius, planar, kinds = place.position, place.query.radius, moves.shape[1] == 4, near.shape[1]
    rest, least, size, above = ranked.rest, ranked.nearest, len(ranked.states), budget / 2 if lower else -1.0
    if size == 0:  # the upper half of an arm of one module has no changes
        return True
    frames, costs = np.zeros((size + 2, moves.shape[1])), np.zeros(size + 1)  # from the half's bottom
    frames[0] = rest[size]
    changed, found = np.empty((2, len(seed)), np.int64), np.empty(len(marks), np.int64)
    changed[0] = seed
    chosen, point, d = np.full(size, -1), np.zeros((1, 4)), 0
    while d >= 0:
        chosen[d] += 1
        i, j = first + d, chosen[d]
        if j == states[i]:
            changed[0, i] = seed[i]
            d -= 1
            continue
        cost = costs[d] + near[i, j]
        if cost > budget:
            continue
        changed[0, i] = j
        compose(frames, d, moves, i * kinds + j, frames, d + 1)
        if d + 1 < size and cost + least[d + 1] <= budget:
            d += 1
            costs[d], chosen[d] = cost, -1
            continue
        if cost <= above:
            continue
        compose(frames, d + 1, rest, d + 1, frames, size + 1)
        matching_point(frames, size + 1, not lower, goal, point, 0)
        point[0, 3] = budget - cost
        if point[0, 3] < half.least and square_between(point, marks, 0) > radius * radius:
            continue
        for k in range(find_near(marks, links, heads, point, radius, planar, found)):
            if not list_match(place, scene, half, found[k], changed, listed):
                return False
    return True
