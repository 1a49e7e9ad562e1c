"""The last modules of a configuration: an exact table of all their tips, for what pixels are too coarse to decide."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import boolean, float64, int64, njit, types
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.scene import Scene, for_scenes, segment_collides, stand
from controller.search.frame_rows import F1, F2, F3, I1, named
from controller.workspace.reachability import TABLES, Tables

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_POINTS = 1 << 16
MOST_BRANCHES = 64
POINTS_A_CELL = 2
MOST_CHECKS = 1 << 12  # collision checks of a branch: enough unless nearly all configurations touch


class DistalTable(NamedTuple):
    """All tips of modules depth+1 to B in frame F_depth, sorted into cells for search by distance.

    Attributes:
        root: number of modules that the densities decide; those from root+1 to depth are all tried over the table.
        depth: number of modules below the table.
        points: tips, in the order of the mixed-radix number that their states spell, first module most significant,
            shape (n, 3).
        turns: their rotations, likewise, shape (n, 3, 3).
        cell: side of a cell.
        corner: least corner of the cells' box, shape (3,).
        shape: cells along x, y, z, shape (3,).
        starts: where each cell's points start in `order`, shape (cells + 1,).
        order: indices into `points`, shape (n,).
    """

    root: int
    depth: int
    points: Array
    turns: Array
    cell: float
    corner: Array
    shape: Index
    starts: Index
    order: Index


class Wanted(NamedTuple):
    """What the table is asked for.

    Attributes:
        rotation: of the goal, shape (3, 3).
        tolerance: of the distance.
        chord: greatest squared chord of the rotations.
        weight: of rotations, see Target.
    """

    rotation: Array
    tolerance: float
    chord: float
    weight: float


DISTAL = named(DistalTable, int64, int64, F2, F3, float64, F1, I1, I1, I1)
TRIPLE: Any = types.Tuple((int64, float64, float64))  # type: ignore[no-untyped-call]
PAIR: Any = types.Tuple((float64, boolean))  # type: ignore[no-untyped-call]
WANTED = named(Wanted, F2, float64, float64, float64)


@lru_cache(maxsize=2)  # planning and following share it
def build_distal_table(manipulator: Manipulator) -> DistalTable:
    """Returns the table of as many of the last modules as have at most MOST_POINTS configurations, at least of one.

    The modules before them that have together at most MOST_BRANCHES configurations are tried one and all.
    """
    depth = lowest(manipulator.states, len(manipulator.modules) - 1, MOST_POINTS)
    points, turns = np.zeros((1, 3)), np.eye(3)[None]
    for i in reversed(range(depth, len(manipulator.modules))):
        k = manipulator.states[i]
        turned = np.einsum("jab,nb->jna", manipulator.rotations[i, :k], points)
        points = (turned + manipulator.translations[i, :k, None]).reshape(-1, 3)
        turns = (manipulator.rotations[i, :k, None] @ turns).reshape(-1, 3, 3)
    points = np.ascontiguousarray(points)
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    # The greatest of what a line, a plane and a space of points ask, so that flat and thin boxes have few cells too.
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
        np.ascontiguousarray(turns),
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
    best_penalty: float,
    best_square: float,
    table: DistalTable,
    penalties: Array,
    states: Index,
    scene: Scene | None,
) -> tuple[int, float, float]:
    """Finds the row of the table that brings the tip to a position (3,), if it is better than the best so far.

    Within the tolerances less penalty is better, ties broken by distance; outside, where the penalty counts as
    infinite, the nearer. Configurations that touch something are skipped; the scene stands at the table's frame.
    Returns the row in the table (-1 if none is better), penalty and squared miss of the best.
    """
    x, y, z, rotation = position[0], position[1], position[2], wanted.rotation
    tolerance, limit, weight, depth = wanted.tolerance, wanted.chord, wanted.weight, table.depth
    points, turns, cell, corner, shape = table.points, table.turns, table.cell, table.corner, table.shape
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
        # Cells of this ring are this far away at the least: go on until neither penalty nor distance can improve.
        square = outside + (max(ring - 1, 0) * cell) ** 2
        if square > tolerance * tolerance and (best_penalty < np.inf or square > best_square):
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
                        penalty, within = np.inf, square <= tolerance * tolerance
                        if oriented:
                            apart = 0.0
                            for a in range(3):
                                for b in range(3):
                                    apart += 0.5 * (turns[n, a, b] - rotation[a, b]) ** 2
                            square += weight * weight * apart
                            within = within and apart <= limit
                        if within:
                            penalty, rest = 0.0, n
                            for i in range(len(states) - 1, depth - 1, -1):
                                penalty += penalties[i, rest % states[i]]
                                rest //= states[i]
                        if penalty < best_penalty or (penalty == best_penalty and square < best_square):
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
                            best, best_penalty, best_square = n, penalty, square
    return best, best_penalty, best_square


@njit("f8[:,::1](f8[:,:], f8[:,::1])", cache=True, nogil=True)
def carried_back(rotation: Array, other: Array) -> Array:
    """Returns R^T R' (3, 3)."""
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
    penalties: Array,
    arm: Tables,
    configuration: Configuration,
    scene: Scene | None,
) -> tuple[float, bool]:
    """Fixes modules root+1 to B; writes their states to `configuration`.

    Of all their configurations whose tip is within the tolerances of the goal, the one with the least sum of penalties
    is taken, ties broken by distance; if there is none, the nearest of all. Among obstacles only MOST_CHECKS of each
    branch are checked.

    Args:
        position: of the goal in frame F_root, shape (3,).
        wanted: rotation of the goal in frame F_0, and tolerances.
        most: nothing is found, and nothing written, if all squared misses are as great.
        table: of the last modules.
        penalties: the secondary criterion, shape (B, Kmax).
        arm: configuration sets.
        configuration: written, shape (B,); its first `root` modules are those that the goal was carried through.
        scene: obstacles, None if there are none; the first `root` modules are clear.

    Returns:
        the squared miss, see Target, `most` if nothing is found, and whether it is within.
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
            stand(scene, i, configuration[i])
    best_row, best_branch, best_penalty, best_square = -1, -1, np.inf, most
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
            base += penalties[i, j]
            if weight > 0.0:
                turned = carried_back(r, turned)
        goal[0], goal[1], goal[2] = qx, qy, qz
        here = Wanted(turned, wanted.tolerance, wanted.chord, weight)
        row, penalty, square = nearest(goal, here, best_penalty - base, best_square, table, penalties, states, scene)
        if row >= 0:
            best_row, best_branch, best_penalty, best_square = row, branch, penalty + base, square
    if best_row < 0:
        return best_square, False
    for i in range(root, depth):
        configuration[i] = best_branch % states[i]
        best_branch //= states[i]
    for i in range(len(states) - 1, depth - 1, -1):
        configuration[i] = best_row % states[i]
        best_row //= states[i]
    return best_square, best_penalty < np.inf
