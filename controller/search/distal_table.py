"""The distal table: all tips of the last modules, exactly, as pixels are too coarse to decide on them."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import boolean, float64, int64, njit, types
from numpy.typing import NDArray

from controller.manipulator.kernel_types import F1, F2, F3, I1, named
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.scene import Scene, for_scenes, segment_collides, set_state
from controller.workspace.reachability import TABLES, Tables

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_POINTS = 1 << 16
MOST_BRANCHES = 64
POINTS_A_CELL = 2  # mean number of points in a cell
MOST_CHECKS = 1 << 12  # most collision checks of a branch


class DistalTable(NamedTuple):
    """All tips of modules depth+1 to B in frame F_depth, sorted into cells.

    Attributes:
        root: number of modules that the densities decide; all states of modules root+1 to depth are tried.
        depth: number of modules below the table.
        points: positions of the tips, shape (n, 3). A row's number has the module states as mixed-radix digits, the
            first module most significant.
        rotations: rotations of the tips, shape (n, 3, 3).
        cell: side of a cell.
        corner: least corner of all cells, shape (3,).
        shape: number of cells along x, y, z, shape (3,).
        starts: first point of each cell in `order`, shape (cells + 1,).
        order: rows of `points`, cell by cell, shape (n,).
    """

    root: int
    depth: int
    points: Array
    rotations: Array
    cell: float
    corner: Array
    shape: Index
    starts: Index
    order: Index


class Wanted(NamedTuple):
    """Rotation and tolerances of a goal.

    Attributes:
        rotation: shape (3, 3).
        tolerance: greatest distance.
        chord: greatest squared chord of the rotations.
        weight: weight of rotations, see SearchTarget.
    """

    rotation: Array
    tolerance: float
    chord: float
    weight: float


DISTAL = named(DistalTable, int64, int64, F2, F3, float64, F1, I1, I1, I1)
TRIPLE: Any = types.Tuple((int64, float64, float64))  # type: ignore[no-untyped-call]
PAIR: Any = types.Tuple((float64, boolean))  # type: ignore[no-untyped-call]
WANTED = named(Wanted, F2, float64, float64, float64)


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


@njit(
    for_scenes(lambda scene: TRIPLE(F1, WANTED, float64, float64, DISTAL, F2, I1, scene)),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def nearest(
    position: Array,
    wanted: Wanted,
    best_cost: float,
    best_square: float,
    table: DistalTable,
    stage_costs: Array,
    states: Index,
    scene: Scene | None,
) -> tuple[int, float, float]:
    """Returns row, cost and squared error of the best row of the table for a position (3,); row -1 if none is better.

    Within the tolerances the least cost is the best; ties are broken by distance. Outside, the cost is infinite, and
    the nearest row is the best. Configurations that collide are skipped; the scene must be set up to the table's frame.
    """
    x, y, z, rotation = position[0], position[1], position[2], wanted.rotation
    tolerance, chord, weight, depth = wanted.tolerance, wanted.chord, wanted.weight, table.depth
    points, rotations, cell, corner, shape = table.points, table.rotations, table.cell, table.corner, table.shape
    starts, order = table.starts, table.order
    oriented = weight > 0.0
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
        if square > tolerance * tolerance and (best_cost < np.inf or square > best_square):
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
                        cost, within = np.inf, square <= tolerance * tolerance
                        if oriented:
                            apart = 0.0
                            for a in range(3):
                                for b in range(3):
                                    apart += 0.5 * (rotations[n, a, b] - rotation[a, b]) ** 2
                            square += weight * weight * apart
                            within = within and apart <= chord
                        if within:
                            cost, rest = 0.0, n
                            for i in range(len(states) - 1, depth - 1, -1):
                                cost += stage_costs[i, rest % states[i]]
                                rest //= states[i]
                        if cost < best_cost or (cost == best_cost and square < best_square):
                            if scene is not None:
                                if scene.checks[0] == 0:
                                    continue
                                scene.checks[0] -= 1
                                rest = n
                                for i in range(len(states) - 1, depth - 1, -1):
                                    scene.states[i] = rest % states[i]
                                    rest //= states[i]
                                if segment_collides(scene, depth, len(states)):
                                    continue
                            best, best_cost, best_square = n, cost, square
    return best, best_cost, best_square


@njit("f8[:,::1](f8[:,:], f8[:,::1])", cache=True, nogil=True)
def carried_back(rotation: Array, other: Array) -> Array:
    """Returns the product R^T R' (3, 3) of rotations R and R' (3, 3)."""
    result = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for c in range(3):
                result[a, b] += rotation[c, a] * other[c, b]
    return result


@njit(
    for_scenes(lambda scene: PAIR(F1, WANTED, float64, DISTAL, F2, TABLES, I1, scene)),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def finish(
    position: Array,
    wanted: Wanted,
    most: float,
    table: DistalTable,
    stage_costs: Array,
    arm: Tables,
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
        table: the distal table.
        stage_costs: the secondary criterion, shape (B, Kmax).
        arm: configuration sets.
        configuration: written, shape (B,); its first `root` states are decided.
        scene: obstacles, None if there are none; the first `root` modules are clear.

    Returns:
        the squared error, see SearchTarget, `most` if nothing is found; and whether it is within the tolerances.
    """
    rotations, translations, states = arm
    root, depth, weight, seen = table.root, table.depth, wanted.weight, wanted.rotation
    branches, goal = 1, np.empty(3)
    for i in range(depth):
        if i >= root:
            branches *= states[i]
        elif weight > 0.0:
            seen = carried_back(rotations[i, configuration[i]], seen)
    if scene is not None:
        for i in range(root):
            set_state(scene, i, configuration[i])
    best_row, best_branch, best_cost, best_square = -1, -1, np.inf, most
    for branch in range(branches):
        if scene is not None:
            rest = branch
            for i in range(root, depth):
                scene.states[i] = rest % states[i]
                rest //= states[i]
            if segment_collides(scene, root, depth):
                continue
            scene.checks[0] = MOST_CHECKS
        qx, qy, qz, base, rest, turned = position[0], position[1], position[2], 0.0, branch, seen
        for i in range(root, depth):
            j = rest % states[i]
            rest //= states[i]
            r, b = rotations[i, j], translations[i, j]
            dx, dy, dz = qx - b[0], qy - b[1], qz - b[2]
            qx = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
            qy = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
            qz = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
            base += stage_costs[i, j]
            if weight > 0.0:
                turned = carried_back(r, turned)
        goal[0], goal[1], goal[2] = qx, qy, qz
        here = Wanted(turned, wanted.tolerance, wanted.chord, weight)
        row, cost, square = nearest(goal, here, best_cost - base, best_square, table, stage_costs, states, scene)
        if row >= 0:
            best_row, best_branch, best_cost, best_square = row, branch, cost + base, square
    if best_row < 0:
        return best_square, False
    for i in range(root, depth):
        configuration[i] = best_branch % states[i]
        best_branch //= states[i]
    for i in range(len(states) - 1, depth - 1, -1):
        configuration[i] = best_row % states[i]
        best_row //= states[i]
    return best_square, best_cost < np.inf
