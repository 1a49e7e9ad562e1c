"""The last modules of a configuration: the best of all that they can do, by the exact table of their tips."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.search.guard import KINDS, LEFT, STATES, Guard, blocked, stand
from controller.search.tail import TABLE, Table

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_CHECKS = 1 << 12  # of a branch's configurations, whether they touch something: where nearly all do, no more


@njit(
    [
        f"Tuple((i8, f8, f8))(f8, f8, f8, f8[:,::1], f8, f8, f8, f8, f8, {TABLE}, f8[:,::1], i8[::1], i8, {guard})"
        for guard in KINDS
    ],
    cache=True,
    nogil=True,
    error_model="numpy",
)
def nearest(
    x: float,
    y: float,
    z: float,
    rotation: Array,
    tolerance: float,
    limit: float,
    weight: float,
    best_penalty: float,
    best_square: float,
    table: Table,
    penalties: Array,
    states: Index,
    depth: int,
    guard: Guard,
) -> tuple[int, float, float]:
    """Finds the row to take for the tip to come to (x, y, z), turned, if it is better than the best so far.

    Within `tolerance` and `limit` the less penalty is better, and the nearer between equals; outside, where the penalty
    counts as infinite, the nearer. What touches something is passed over; the guard stands at the table's frame.
    Returns the row in the table (-1 if none is better), penalty and square of the distance of the best.
    """
    points, turns, cell, corner, shape, starts, order = table
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
                            if guard is not None:
                                if guard[LEFT][0] == 0:
                                    continue
                                guard[LEFT][0] -= 1
                                rest = n
                                for i in range(len(states) - 1, depth - 1, -1):
                                    guard[STATES][i] = rest % states[i]
                                    rest //= states[i]
                                if blocked(guard, depth, len(states)):
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
    [
        f"Tuple((f8, b1))(f8, f8, f8, f8[:,::1], f8, f8, f8, f8, i8, i8, {TABLE}, f8[:,::1], f8[:,:,:,::1],"
        f" f8[:,:,::1], i8[::1], i8[::1], {guard})"
        for guard in KINDS
    ],
    cache=True,
    nogil=True,
    error_model="numpy",
)
def finish(
    x: float,
    y: float,
    z: float,
    rotation: Array,
    tolerance: float,
    limit: float,
    weight: float,
    most: float,
    root: int,
    depth: int,
    table: Table,
    penalties: Array,
    rotations: Array,
    translations: Array,
    states: Index,
    configuration: Index,
    guard: Guard,
) -> tuple[float, bool]:
    """Fixes modules root+1 to B; writes their states to `configuration`.

    Of all their configurations whose tip is within `tolerance` and `limit` of the goal, the one with the least sum of
    penalties is taken, the nearer deciding between equals; if there is none, the nearest of all. With a guard only
    MOST_CHECKS of each branch are looked at.

    Args:
        x: goal in frame F_root; `y` and `z` likewise.
        y: see x.
        z: see x.
        rotation: of the goal in frame F_0, shape (3, 3).
        tolerance: distance within which penalties decide.
        limit: and the next: see Target.
        weight: see Target.
        most: squares from there on do not matter: nothing is found, nothing written, if all are.
        root: see Tail.
        depth: see Tail.
        table: see Tail.
        penalties: the secondary criterion, shape (B, Kmax).
        rotations: configuration sets, shape (B, Kmax, 3, 3).
        translations: configuration sets, shape (B, Kmax, 3).
        states: K_i, shape (B,).
        configuration: written, shape (B,); its first `root` modules are those that the goal was carried through.
        guard: what to keep clear of, None if there is nothing; the first `root` modules are clear.

    Returns:
        the square by which the tip misses, see Target, `most` if nothing is found, and whether it is within.
    """
    branches, wanted = 1, rotation
    for i in range(depth):
        if i >= root:
            branches *= states[i]
        elif weight > 0.0:
            wanted = carried_back(rotations[i, configuration[i]], wanted)
    if guard is not None:
        for i in range(root):
            stand(guard, i, configuration[i])
    best_row, best_branch, best_penalty, best_square = -1, -1, np.inf, most
    for branch in range(branches):
        if guard is not None:
            rest = branch
            for i in range(root, depth):
                guard[STATES][i] = rest % states[i]
                rest //= states[i]
            if blocked(guard, root, depth):
                continue
            guard[LEFT][0] = MOST_CHECKS
        qx, qy, qz, base, rest, turned = x, y, z, 0.0, branch, wanted
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
        row, penalty, square = nearest(
            qx,
            qy,
            qz,
            turned,
            tolerance,
            limit,
            weight,
            best_penalty - base,
            best_square,
            table,
            penalties,
            states,
            depth,
            guard,
        )
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
