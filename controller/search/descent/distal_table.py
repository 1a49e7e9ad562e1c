"""The distal table: all tips of the last modules, exactly, as pixels are too coarse to decide on them."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import boolean, float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, I1, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.scene import SCENE, Scene, for_scenes, segment_collides, set_state
from hyperbit.controller.workspace.reachability import POINT, TABLES, ReachTables, seen_from

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Point = tuple[float, float, float]

MOST_POINTS = 1 << 16
MOST_BRANCHES = 64
POINTS_A_CELL = 2  # mean number of points in a cell
MOST_CHECKS = 1 << 12  # most collision checks of a branch


class DistalTable(NamedTuple):
    """All tips of modules depth+1 to B in frame F_depth, sorted into cells."""

    root: int  # number of modules that the densities decide; all states of modules root+1 to depth are tried
    depth: int  # number of modules below the table
    # positions of the tips, shape (n, 3). A row's number has the module states as mixed-radix digits, the first module
    # most significant.
    points: Array
    rotations: Array  # rotations of the tips, shape (n, 3, 3)
    cell: float  # side of a cell
    corner: Array  # least corner of all cells, shape (3,)
    shape: Index  # number of cells along x, y, z, shape (3,)
    starts: Index  # first point of each cell in `order`, shape (cells + 1,)
    order: Index  # rows of `points`, cell by cell, shape (n,)


class Wanted(NamedTuple):
    """Rotation and tolerances of a goal."""

    rotation: Array  # shape (3, 3)
    tolerance: float  # greatest distance
    chord: float  # greatest squared chord of the rotations
    weight: float  # weight of rotations, see SearchTarget


class DistalSearch(NamedTuple):
    """What a search of the distal table goes by."""

    table: DistalTable  # the distal table
    costs: Array  # cost of each module's states, shape (B, Kmax)
    arm: ReachTables  # configuration sets


DISTAL = named(DistalTable, int64, int64, F2, F3, float64, F1, I1, I1, I1)
TRIPLE: Any = types.Tuple((int64, float64, float64))  # type: ignore[no-untyped-call]
PAIR: Any = types.UniTuple(float64, 2)  # type: ignore[no-untyped-call]
SEEN: Any = types.Tuple((POINT, float64))  # type: ignore[no-untyped-call]
FINISHED: Any = types.Tuple((float64, boolean))  # type: ignore[no-untyped-call]
WANTED = named(Wanted, F2, float64, float64, float64)
DISTAL_SEARCH = named(DistalSearch, DISTAL, F2, TABLES)


@lru_cache(maxsize=2)  # shared by the solvers of goals and of set-points
def build_distal_table(manipulator: Manipulator) -> DistalTable:
    """Returns the table of the last modules: as many as have at most MOST_POINTS configurations, at least one.

    Below the table, all configurations of as many modules as have at most MOST_BRANCHES configurations are tried.
    """
    depth = lowest(manipulator.states, len(manipulator.modules) - 1, MOST_POINTS)
    points, rotations = np.zeros((1, 3)), np.eye(3)[None]
    for i in reversed(range(depth, len(manipulator.modules))):
        k = manipulator.states[i]
        turned = np.einsum("jab,nb->jna", manipulator.rotations[i, :k], points)
        points = (turned + manipulator.translations[i, :k, None]).reshape(-1, 3)
        rotations = (manipulator.rotations[i, :k, None] @ rotations).reshape(-1, 3, 3)
    points = np.ascontiguousarray(points)
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    # The cell side is the greatest for a line, a plane and a volume of points, so that flat boxes have few cells, too.
    extents = np.sort(size)[::-1]
    cell = max(float(np.prod(extents[:n]) / len(points) * POINTS_A_CELL) ** (1 / n) for n in (1, 2, 3)) or 1.0
    shape = (size / cell).astype(np.int64) + 1
    cells = ((points - low) / cell).astype(np.int64)
    flat = (cells[:, 2] * shape[1] + cells[:, 1]) * shape[0] + cells[:, 0]
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=int(shape.prod())))])
    root = lowest(manipulator.states, depth, MOST_BRANCHES)
    return DistalTable(
        root,
        depth,
        points,
        np.ascontiguousarray(rotations),
        cell,
        low,
        shape,
        starts.astype(np.int64),
        np.argsort(flat, kind="stable"),
    )


def lowest(states: Index, top: int, most: int) -> int:
    """Returns the least i <= top such that modules i+1 to top+1 (or the last) have at most `most` configurations."""
    i, product = top, 1 if top < len(states) - 1 else int(states[-1])
    while i > 0 and product * states[i - 1] <= most:
        i -= 1
        product *= int(states[i])
    return i


@kernel([PAIR(int64, float64, WANTED, DISTAL_SEARCH)], **UNCOUNTED, error_model="numpy")
def rate(row: int, square: float, wanted: Wanted, search: DistalSearch) -> tuple[float, float]:
    """Returns cost and squared error of a row whose squared distance is known; outside the tolerances infinite cost."""
    rotations, rotation, states = search.table.rotations, wanted.rotation, search.arm.states
    within = square <= wanted.tolerance * wanted.tolerance
    if wanted.weight > 0.0:
        apart = 0.0
        for a in range(3):
            for b in range(3):
                apart += 0.5 * (rotations[row, a, b] - rotation[a, b]) ** 2
        square += wanted.weight * wanted.weight * apart
        within = within and apart <= wanted.chord
    if not within:
        return np.inf, square
    cost, rest = 0.0, row
    for i in range(len(states) - 1, search.table.depth - 1, -1):
        cost += search.costs[i, rest % states[i]]
        rest //= states[i]
    return cost, square


@kernel(boolean(int64, DISTAL_SEARCH, SCENE), **UNCOUNTED)
def row_collides(row: int, search: DistalSearch, scene: Scene) -> bool:
    """Returns whether the modules of a row collide; also true if no check is left."""
    states, depth = search.arm.states, search.table.depth
    if scene.checks[0] == 0:
        return True
    scene.checks[0] -= 1
    scene.checks[1] += 1
    rest = row
    for i in range(len(states) - 1, depth - 1, -1):
        scene.states[i] = rest % states[i]
        rest //= states[i]
    return bool(segment_collides(scene, depth, len(states)))


@kernel(
    for_scenes(lambda scene: TRIPLE(POINT, WANTED, float64, float64, DISTAL_SEARCH, scene)),
    **UNCOUNTED,
    error_model="numpy",
)
def nearest(
    position: Point,
    wanted: Wanted,
    best_cost: float,
    best_square: float,
    search: DistalSearch,
    scene: Scene | None,
) -> tuple[int, float, float]:
    """Returns row, cost and squared error of the best row of the table for a position; row -1 if none is better.

    Within the tolerances the least cost is the best; ties are broken by distance. Outside, the cost is infinite, and
    the nearest row is the best. Configurations that collide are skipped; the scene must be set up to the table's frame.
    """
    x, y, z, farthest = position[0], position[1], position[2], wanted.tolerance * wanted.tolerance
    _, _, points, _, cell, corner, shape, starts, order = search.table
    cx = min(max(int(np.floor((x - corner[0]) / cell)), 0), shape[0] - 1)
    cy = min(max(int(np.floor((y - corner[1]) / cell)), 0), shape[1] - 1)
    cz = min(max(int(np.floor((z - corner[2]) / cell)), 0), shape[2] - 1)
    ox = x - min(max(x, corner[0]), corner[0] + shape[0] * cell)
    oy = y - min(max(y, corner[1]), corner[1] + shape[1] * cell)
    oz = z - min(max(z, corner[2]), corner[2] + shape[2] * cell)
    outside = ox * ox + oy * oy + oz * oz
    best = -1
    for ring in range(max(shape[0], shape[1], shape[2]) + 1):
        # `square` bounds the distance of the cells of this ring. Stop if neither cost nor distance can improve.
        square = outside + (max(ring - 1, 0) * cell) ** 2
        if square > farthest and (best_cost < np.inf or square > best_square):
            break
        for iz in range(max(cz - ring, 0), min(cz + ring, shape[2] - 1) + 1):
            for iy in range(max(cy - ring, 0), min(cy + ring, shape[1] - 1) + 1):
                inner = ring > 0 and abs(iz - cz) < ring and abs(iy - cy) < ring
                for ix in range(cx - ring, cx + ring + 1, 2 * ring if inner else 1):
                    if ix < 0 or ix >= shape[0]:
                        continue
                    c = (iz * shape[1] + iy) * shape[0] + ix
                    for k in range(starts[c], starts[c + 1]):
                        n = order[k]
                        dx, dy, dz = points[n, 0] - x, points[n, 1] - y, points[n, 2] - z
                        square = dx * dx + dy * dy + dz * dz
                        if square > farthest and (best_cost < np.inf or square >= best_square):
                            continue
                        cost, square = rate(n, square, wanted, search)
                        if cost > best_cost or (cost == best_cost and square >= best_square):
                            continue
                        if scene is None or not row_collides(n, search, scene):
                            best, best_cost, best_square = n, cost, square
    return best, best_cost, best_square


@kernel("f8[:,::1](f8[:,:], f8[:,::1])")
def carried_back(rotation: Array, other: Array) -> Array:
    """Returns the product R^T R' (3, 3) of rotations R and R' (3, 3)."""
    result = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for c in range(3):
                result[a, b] += rotation[c, a] * other[c, b]
    return result


@kernel(boolean(int64, DISTAL_SEARCH, SCENE), **UNCOUNTED)
def branch_collides(branch: int, search: DistalSearch, scene: Scene) -> bool:
    """Returns whether the modules of a branch, root+1 to depth, collide."""
    root, depth, states, rest = search.table.root, search.table.depth, search.arm.states, branch
    scene.checks[1] += 1
    for i in range(root, depth):
        scene.states[i] = rest % states[i]
        rest //= states[i]
    return bool(segment_collides(scene, root, depth))


@kernel([SEEN(int64, F1, DISTAL_SEARCH)], **UNCOUNTED, error_model="numpy")
def seen_from_branch(branch: int, position: Array, search: DistalSearch) -> tuple[Point, float]:
    """Returns a position (3,) of frame F_root as seen from the frame above a branch, and the branch's cost.

    The states of modules root+1 to depth are the digits of `branch`, the first module least significant.
    """
    rotations, translations, states = search.arm
    x, y, z, cost, rest = position[0], position[1], position[2], 0.0, branch
    for i in range(search.table.root, search.table.depth):
        j = rest % states[i]
        rest //= states[i]
        x, y, z = seen_from(rotations[i, j], translations[i, j], x, y, z)
        cost += search.costs[i, j]
    return (x, y, z), cost


@kernel(F2(int64, F2, DISTAL_SEARCH), error_model="numpy")
def turned_back(branch: int, rotation: Array, search: DistalSearch) -> Array:
    """Returns a rotation (3, 3) of frame F_root as seen from the frame above a branch."""
    rotations, _, states = search.arm
    for i in range(search.table.root, search.table.depth):
        rotation = carried_back(rotations[i, branch % states[i]], rotation)
        branch //= states[i]
    return rotation


@kernel(types.void(int64, int64, DISTAL_SEARCH, I1), **UNCOUNTED)
def write_states(branch: int, row: int, search: DistalSearch, configuration: Configuration) -> None:
    """Writes the states of a branch and of a row of the table to `configuration` (B,)."""
    states, depth = search.arm.states, search.table.depth
    for i in range(search.table.root, depth):
        configuration[i] = branch % states[i]
        branch //= states[i]
    for i in range(len(states) - 1, depth - 1, -1):
        configuration[i] = row % states[i]
        row //= states[i]


@kernel(
    for_scenes(lambda scene: FINISHED(F1, WANTED, float64, DISTAL_SEARCH, I1, scene)),
    error_model="numpy",
)
def finish(
    position: Array,
    wanted: Wanted,
    most: float,
    search: DistalSearch,
    configuration: Configuration,
    scene: Scene | None,
) -> tuple[float, bool]:
    """Decides modules root+1 to B; writes their states to `configuration`.

    Of the configurations within the tolerances of the goal, the one with the least cost is taken; ties are broken by
    distance. If there is none, the nearest is taken. With obstacles at most MOST_CHECKS of each branch are checked.

    Args:
        position: position of the goal in frame F_root, shape (3,).
        wanted: rotation of the goal in frame F_0, and tolerances.
        most: squared error that a configuration must be below; otherwise nothing is found, and nothing written.
        search: distal table, secondary criterion as costs, and configuration sets.
        configuration: written, shape (B,); its first `root` states are decided.
        scene: obstacles, None if there are none; the first `root` modules are clear.

    Returns:
        the squared error, see SearchTarget, `most` if nothing is found; and whether it is within the tolerances.
    """
    rotations, _, states = search.arm
    root, depth, oriented, rotation = search.table.root, search.table.depth, wanted.weight > 0.0, wanted.rotation
    for i in range(root):
        if oriented:
            rotation = carried_back(rotations[i, configuration[i]], rotation)
        if scene is not None:
            set_state(scene, i, configuration[i])
    best_row, best_branch, best_cost, best_square = -1, -1, np.inf, most
    for branch in range(states[root:depth].prod()):
        if scene is not None:
            if branch_collides(branch, search, scene):
                continue
            scene.checks[0] = MOST_CHECKS
        goal, base = seen_from_branch(branch, position, search)
        turned = turned_back(branch, rotation, search) if oriented else rotation
        here = Wanted(turned, wanted.tolerance, wanted.chord, wanted.weight)
        row, cost, square = nearest(goal, here, best_cost - base, best_square, search, scene)
        if row >= 0:
            best_row, best_branch, best_cost, best_square = row, branch, cost + base, square
    if best_row >= 0:
        write_states(best_branch, best_row, search, configuration)
    return best_square, best_cost < np.inf
