"""Meeting in the middle: which row of one segment fits which row of the other.

Rigid motions keep distances. So with the arm cut in two, the tip of a pair of rows is as far from the goal as the upper
row's tip is from the goal seen from the top of the lower row, R^T (goal - b). One side's points are sorted into cells;
the other side asks for what is near. Frames are rows of numbers, see frame_rows. Rotations are compared only of what is
near, by the square of their chord, 2 (1 - cos angle): half the sum of the squares by which the matrices differ.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.search.guard import BLOCKED, PAIR_KINDS, Pairs, meets
from controller.search.sorting import SORTED, Sorted

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit("void(f8[::1], f8[:,::1], f8[:,::1])", cache=True, nogil=True, fastmath={"contract"})
def seen(frame: Array, frames: Array, out: Array) -> None:
    """Writes a frame (4,) or (12,) as seen from each of others to `out`, or its position where `out` is no wider."""
    whole = out.shape[1] == frames.shape[1]
    for n in range(len(frames)):
        f = frames[n]
        if len(f) == 4:
            dx, dy = frame[0] - f[0], frame[1] - f[1]
            out[n, 0], out[n, 1] = f[2] * dx + f[3] * dy, f[2] * dy - f[3] * dx
            if whole:
                out[n, 2], out[n, 3] = f[2] * frame[2] + f[3] * frame[3], f[2] * frame[3] - f[3] * frame[2]
        else:
            dx, dy, dz = frame[0] - f[0], frame[1] - f[1], frame[2] - f[2]
            for a in range(3):
                out[n, a] = f[3 + a] * dx + f[6 + a] * dy + f[9 + a] * dz
                if whole:
                    for b in range(3):
                        out[n, 3 + 3 * a + b] = (
                            f[3 + a] * frame[3 + b] + f[6 + a] * frame[6 + b] + f[9 + a] * frame[9 + b]
                        )


@njit("f8(f8[:,::1], i8, f8[:,::1], i8, f8[:,::1], i8)", cache=True, nogil=True, inline="always")
def chord(turned: Array, i: int, by: Array, j: int, other: Array, k: int) -> float:
    """Returns the squared chord between the rotation of turned[i], turned by that of by[j], and that of other[k]."""
    total = 0.0
    if turned.shape[1] == 4:
        c = by[j, 2] * turned[i, 2] - by[j, 3] * turned[i, 3] - other[k, 2]
        s = by[j, 3] * turned[i, 2] + by[j, 2] * turned[i, 3] - other[k, 3]
        return float(c * c + s * s)
    for a in range(3, 12, 3):
        for b in range(3):
            d = by[j, a] * turned[i, 3 + b] + by[j, a + 1] * turned[i, 6 + b] + by[j, a + 2] * turned[i, 9 + b]
            total += (d - other[k, a + b]) ** 2
    return 0.5 * total


@njit(
    [
        f"Tuple((i8, i8, i8, f8, f8))(f8[:,::1], f8[::1], f8[:,::1], f8[::1], b1, {SORTED}, f8, f8, f8, f8, {pairs})"
        for pairs in PAIR_KINDS
    ],
    cache=True,
    nogil=True,
    error_model="numpy",
    fastmath={"contract"},
)
def match(
    targets: Array,
    target_costs: Array,
    frames: Array,
    frame_costs: Array,
    away: bool,
    asked: Sorted,
    tolerance: float,
    weight: float,
    best: float,
    best_square: float,
    pairs: Pairs,
) -> tuple[int, int, int, float, float]:
    """Returns the target, frame and point of least cost together that fit and are clear, the nearer between equals.

    They fit where the point is within the tolerance of the target as seen from the frame, or as carried by it.

    Args:
        targets: frames, shape (t, 4) or (t, 12).
        target_costs: shape (t,).
        frames: shape (n, 4) or (n, 12).
        frame_costs: shape (n,).
        away: whether targets are seen from the frames, R^T (target - b), or carried by them, b + R target.
        asked: points, see sorting; the rows are not read where rotations do not count.
        tolerance: of the distance.
        weight: length with which the chord between rotations counts in the squared distance; 0 where it does not.
        best: cost to be bettered, or equalled by what is nearer.
        best_square: square of its distance.
        pairs: what to keep clear of, see guard; None if there is nothing.

    Returns:
        Rows of target, frame and asked row, (-1, -1, -1) if none is better; the best's cost and squared distance.
    """
    points, prices, starts, order, grid, rows = asked
    least = np.inf
    for k in range(len(prices)):
        least = min(least, prices[k])
    first, second, third = -1, -1, -1
    farthest, flat, oriented = tolerance * tolerance, frames.shape[1] == 4, weight > 0.0
    per, nx, ny, nz = grid[6], int(grid[7]), int(grid[8]), int(grid[9])
    dz = 0.0
    if pairs is not None:
        known = pairs[2]
    for t in range(len(targets)):
        x, y, z = targets[t, 0], targets[t, 1], 0.0 if flat else targets[t, 2]
        for q in range(len(frames)):
            price = target_costs[t] + frame_costs[q]
            if price + least > best:
                continue
            if pairs is not None and len(known) > 0 and known[q] == BLOCKED:
                continue
            f = frames[q]
            pz = 0.0
            if flat and away:
                dx, dy = x - f[0], y - f[1]
                px, py = f[2] * dx + f[3] * dy, f[2] * dy - f[3] * dx
            elif flat:
                px, py = f[0] + f[2] * x - f[3] * y, f[1] + f[3] * x + f[2] * y
            elif away:
                dx, dy, dz = x - f[0], y - f[1], z - f[2]
                px = f[3] * dx + f[6] * dy + f[9] * dz
                py = f[4] * dx + f[7] * dy + f[10] * dz
                pz = f[5] * dx + f[8] * dy + f[11] * dz
            else:
                px = f[0] + f[3] * x + f[4] * y + f[5] * z
                py = f[1] + f[6] * x + f[7] * y + f[8] * z
                pz = f[2] + f[9] * x + f[10] * y + f[11] * z
            ux, uy = (px - grid[0]) * per - 0.5, (py - grid[1]) * per - 0.5
            if not (-1.0 <= ux < nx and -1.0 <= uy < ny):
                continue
            cx, cy, z0, z1 = int(np.floor(ux)), int(np.floor(uy)), 0, 1
            if not flat:
                uz = (pz - grid[2]) * per - 0.5
                if not -1.0 <= uz < nz:
                    continue
                cz = int(np.floor(uz))
                z0, z1 = max(cz, 0), min(cz + 2, nz)
            x0, x1 = max(cx, 0), min(cx + 2, nx)
            for iz in range(z0, z1):
                for iy in range(max(cy, 0), min(cy + 2, ny)):
                    row = (iz * ny + iy) * nx
                    # Cells of a row lie one after the other, so their points do.
                    for k in range(starts[row + x0], starts[row + x1]):
                        dx, dy = px - points[k, 0], py - points[k, 1]
                        square = dx * dx + dy * dy
                        if not flat:
                            dz = pz - points[k, 2]
                            square += dz * dz
                        if square > farthest:
                            continue
                        cost = price + prices[k]
                        if cost < best or (cost == best and square < best_square):
                            if oriented:
                                if away:
                                    apart = chord(rows, order[k], frames, q, targets, t)
                                else:
                                    apart = chord(targets, t, frames, q, rows, order[k])
                                square += weight * weight * apart
                                if cost == best and square >= best_square:
                                    continue
                            if pairs is not None and meets(pairs, t, q, order[k]):
                                continue
                            first, second, third, best, best_square = t, q, k, cost, square
    return first, second, int(order[third]) if third >= 0 else -1, best, best_square


@njit(
    [f"i8(f8[:,::1], f8[::1], {SORTED}, f8, f8, i8[:,::1], f8[::1], {pairs})" for pairs in PAIR_KINDS],
    cache=True,
    nogil=True,
    error_model="numpy",
)
def collect(
    asking: Array,
    asking_costs: Array,
    asked: Sorted,
    tolerance: float,
    limit: float,
    found: Index,
    costs: Array,
    pairs: Pairs,
) -> int:
    """Writes the cheapest pairs of an asking frame (n, 4 or 12) and a row that fit, see match, as many as find room.

    Returns their number; `found` is of shape (n, 2), their `costs` of shape (n,). The rest: see match.
    """
    points, prices, starts, order, grid, rows = asked
    count, room, worst, farthest = 0, len(costs), np.inf, tolerance * tolerance
    size = points.shape[1]
    flat, oriented = size == 2, limit < np.inf
    per, nx, ny, nz = grid[6], int(grid[7]), int(grid[8]), int(grid[9])
    for q in range(len(asking)):
        if asking_costs[q] > worst:
            continue
        ux, uy = (asking[q, 0] - grid[0]) * per - 0.5, (asking[q, 1] - grid[1]) * per - 0.5
        uz = -0.5 if flat else (asking[q, 2] - grid[2]) * per - 0.5
        if not (-1.0 <= ux < nx and -1.0 <= uy < ny and -1.0 <= uz < nz):
            continue
        cx, cy, cz = int(np.floor(ux)), int(np.floor(uy)), int(np.floor(uz))
        for iz in range(max(cz, 0), min(cz + 2, nz)):
            for iy in range(max(cy, 0), min(cy + 2, ny)):
                row = (iz * ny + iy) * nx
                for k in range(starts[row + max(cx, 0)], starts[row + min(cx + 2, nx)]):
                    cost = asking_costs[q] + prices[k]
                    if cost > worst or (count == room and cost == worst):
                        continue
                    square = 0.0
                    for a in range(size):
                        square += (asking[q, a] - points[k, a]) ** 2
                    if square > farthest:
                        continue
                    if oriented:
                        apart, n = 0.0, order[k]
                        for a in range(size, asking.shape[1]):
                            apart += (asking[q, a] - rows[n, a]) ** 2
                        if apart > (limit if flat else 2.0 * limit):
                            continue
                    if pairs is not None and meets(pairs, 0, q, order[k]):
                        continue
                    at = count
                    if count == room:  # the dearest gives way
                        at = int(np.argmax(costs))
                    else:
                        count += 1
                    found[at, 0], found[at, 1], costs[at] = q, order[k], cost
                    if count == room:
                        worst = costs.max()
    return count
