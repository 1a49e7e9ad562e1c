"""Meeting of poses: cells of position and rotation together, so that few rows are asked for each pose.

The axis of a rotation times the sine of its angle, half the vector of R - R^T, moves by no more than the chord between
two rotations. Times a weight that makes the chords' limit as long as the distance's, it stands beside the position as
more coordinates of one point: the sine of the angle in the plane, three elsewhere.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.search.frame_rows import compose
from controller.search.guard import BLOCKED, PAIR_KINDS, Pairs, meets
from controller.search.meeting import chord
from controller.search.sorting import SORTED, Sorted

Array = NDArray[np.float64]


@njit("void(f8[:,::1], i8, f8, f8[:,::1], i8)", cache=True, nogil=True, inline="always")
def spread(rows: Array, n: int, weight: float, points: Array, k: int) -> None:
    """Writes the point of rows[n] to points[k], of three coordinates in the plane, six elsewhere."""
    if rows.shape[1] == 4:
        points[k, 0], points[k, 1], points[k, 2] = rows[n, 0], rows[n, 1], weight * rows[n, 3]
    else:
        points[k, 0], points[k, 1], points[k, 2] = rows[n, 0], rows[n, 1], rows[n, 2]
        points[k, 3] = 0.5 * weight * (rows[n, 10] - rows[n, 8])
        points[k, 4] = 0.5 * weight * (rows[n, 5] - rows[n, 9])
        points[k, 5] = 0.5 * weight * (rows[n, 6] - rows[n, 4])


@njit("void(f8[:,::1], f8, f8[:,::1])", cache=True, nogil=True)
def write_points(rows: Array, weight: float, points: Array) -> None:
    """Writes the points (n, 3 or 6) of rows (n, 4 or 12)."""
    for n in range(len(rows)):
        spread(rows, n, weight, points, n)


@njit("void(f8[:,::1], i8, f8[:,::1], i8, f8[:,::1])", cache=True, nogil=True, inline="always")
def see(targets: Array, t: int, frames: Array, q: int, out: Array) -> None:
    """Writes frame targets[t] as seen from frames[q] to out[0]."""
    if out.shape[1] == 4:
        dx, dy, c, s = targets[t, 0] - frames[q, 0], targets[t, 1] - frames[q, 1], frames[q, 2], frames[q, 3]
        out[0, 0], out[0, 1] = c * dx + s * dy, c * dy - s * dx
        out[0, 2], out[0, 3] = c * targets[t, 2] + s * targets[t, 3], c * targets[t, 3] - s * targets[t, 2]
    else:
        dx, dy, dz = targets[t, 0] - frames[q, 0], targets[t, 1] - frames[q, 1], targets[t, 2] - frames[q, 2]
        for a in range(3):
            u, v, w = frames[q, 3 + a], frames[q, 6 + a], frames[q, 9 + a]
            out[0, a] = u * dx + v * dy + w * dz
            for b in range(3):
                out[0, 3 + 3 * a + b] = u * targets[t, 3 + b] + v * targets[t, 6 + b] + w * targets[t, 9 + b]


@njit(
    [
        f"Tuple((i8, i8, i8, f8, f8))(f8[:,::1], f8[::1], f8[:,::1], f8[::1], b1, {SORTED}, f8, f8, f8, f8, f8,"
        f" {pairs})"
        for pairs in PAIR_KINDS
    ],
    cache=True,
    nogil=True,
    error_model="numpy",
    fastmath={"contract"},
)
def match_poses(
    targets: Array,
    target_costs: Array,
    frames: Array,
    frame_costs: Array,
    away: bool,
    asked: Sorted,
    tolerance: float,
    limit: float,
    weight: float,
    best: float,
    best_square: float,
    pairs: Pairs,
) -> tuple[int, int, int, float, float]:
    """Returns the target, frame and row of least cost together that fit and are clear, the nearer between equals.

    They fit where the row's position is within the tolerance of the target's as seen from the frame, or as carried by
    it, and the squared chord between their rotations within the limit.

    Args:
        targets: frames, shape (t, 4) or (t, 12).
        target_costs: shape (t,).
        frames: shape (n, 4) or (n, 12).
        frame_costs: shape (n,).
        away: whether targets are seen from the frames or carried by them.
        asked: points, see sorting.
        tolerance: of the distance.
        limit: of the rotations' squared chord.
        weight: length with which chords count in the squared distance.
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
    size, width, farthest = points.shape[1], frames.shape[1], tolerance * tolerance
    place, per, shape = 2 if width == 4 else 3, grid[6], np.empty(size, dtype=np.int64)
    for a in range(size):
        shape[a] = int(grid[7 + a])
    wanted, point, low = np.empty((1, width)), np.empty((1, size)), np.empty(size, dtype=np.int64)
    turns = tolerance / np.sqrt(limit)
    if pairs is not None:
        known = pairs[2]
    for t in range(len(targets)):
        for q in range(len(frames)):
            price = target_costs[t] + frame_costs[q]
            if price + least > best:
                continue
            if pairs is not None and len(known) > 0 and known[q] == BLOCKED:
                continue
            if away:
                see(targets, t, frames, q, wanted)
            else:
                compose(frames, q, targets, t, wanted, 0)
            spread(wanted, 0, turns, point, 0)
            outside = False
            for a in range(size):
                u = (point[0, a] - grid[a]) * per - 0.5
                if not -1.0 <= u < shape[a]:
                    outside = True
                    break
                low[a] = int(np.floor(u))
            if outside:
                continue
            x0, x1 = max(low[0], 0), min(low[0] + 2, shape[0])
            # All cells next to the point: the lower or the upper one along each coordinate but the first, along which
            # cells lie one after the other, and so do their points.
            for corner in range(1 << (size - 1)):
                row, beside = 0, False
                for a in range(size - 1, 0, -1):
                    c = low[a] + ((corner >> (a - 1)) & 1)
                    if c < 0 or c >= shape[a]:
                        beside = True
                        break
                    row = row * shape[a] + c
                if beside:
                    continue
                row *= shape[0]
                for k in range(starts[row + x0], starts[row + x1]):
                    cost = price + prices[k]
                    if cost > best:
                        continue
                    square = 0.0
                    for a in range(place):
                        square += (point[0, a] - points[k, a]) ** 2
                    if square > farthest or (cost == best and square >= best_square):
                        continue
                    turned = 0.0
                    for a in range(place, size):
                        turned += (point[0, a] - points[k, a]) ** 2
                    if turned > farthest * (1 + 1e-9):
                        continue
                    n = order[k]
                    apart = chord(targets, t, frames, q, rows, n) if not away else chord(rows, n, frames, q, targets, t)
                    square += weight * weight * apart
                    if apart > limit or (cost == best and square >= best_square):
                        continue
                    if pairs is not None and meets(pairs, t, q, n):
                        continue
                    first, second, third, best, best_square = t, q, n, cost, square
    return first, second, third, best, best_square
