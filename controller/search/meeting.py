"""Meeting in the middle: which row of one segment fits which row of the other.

Rigid motions keep distances. So with the arm cut in two, the tip of a pair of rows is as far from the goal as the upper
row's tip is from the goal seen from the top of the lower row, R^T (goal - b). One side's points are sorted into cells;
the other side asks for what is near.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Index32 = NDArray[np.int32]

CELLS = 1 << 17


@njit("void(f8[::1], f8[:,:,::1], f8[:,::1], f8[:,::1])", cache=True, nogil=True, fastmath={"contract"})
def seen(goal: Array, rotations: Array, positions: Array, out: Array) -> None:
    """Writes the goal as seen from each frame, R^T (goal - b), to `out` (n, 3)."""
    for n in range(len(positions)):
        r, b = rotations[n], positions[n]
        x, y, z = goal[0] - b[0], goal[1] - b[1], goal[2] - b[2]
        out[n, 0] = r[0, 0] * x + r[1, 0] * y + r[2, 0] * z
        out[n, 1] = r[0, 1] * x + r[1, 1] * y + r[2, 1] * z
        out[n, 2] = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z


@njit("void(f8[::1], f8[:,:,::1], f8[:,::1], f8[:,::1])", cache=True, nogil=True, fastmath={"contract"})
def carried(point: Array, rotations: Array, positions: Array, out: Array) -> None:
    """Writes where each frame carries a point, b + R point, to `out` (n, 3)."""
    for n in range(len(positions)):
        r, b = rotations[n], positions[n]
        for a in range(3):
            out[n, a] = b[a] + r[a, 0] * point[0] + r[a, 1] * point[1] + r[a, 2] * point[2]


@njit("i8(f8[::1], f8[::1], f8, i8[::1])", cache=True, nogil=True, error_model="numpy", inline="always")
def place(point: Array, corner: Array, cell: float, shape: Index) -> int:
    """Returns the cell a point lies in."""
    x, y, z = (point[0] - corner[0]) / cell, (point[1] - corner[1]) / cell, (point[2] - corner[2]) / cell
    return int((int(z) * shape[1] + int(y)) * shape[0] + int(x))


@njit("Tuple((f8, i8))(f8[:,::1], f8, i4[::1], i4[::1], f8[::1], i8[::1])", cache=True, nogil=True, error_model="numpy")
def sort_into_cells(
    points: Array, tolerance: float, starts: Index32, order: Index32, corner: Array, shape: Index
) -> tuple[float, int]:
    """Sorts points (n, 3) into cells at least two tolerances wide; returns the cells' side and number.

    Writes `starts` (cells + 1,), `order` (n,), `corner` (3,) and `shape` (3,).
    """
    high = np.full(3, -np.inf)
    corner[:] = np.inf
    for n in range(len(points)):
        for a in range(3):
            corner[a] = min(corner[a], points[n, a])
            high[a] = max(high[a], points[n, a])
    most = min(len(starts) - 1, 8 * len(points) + 64)
    cell = 2.0 * tolerance
    while True:
        cells = 1.0
        for a in range(3):
            corner_cells = np.floor((high[a] - corner[a]) / cell) + 1.0
            shape[a] = np.int64(min(corner_cells, 1e9))
            cells *= corner_cells
        if cells <= most:
            break
        cell *= 1.25
    count = shape[0] * shape[1] * shape[2]
    starts[: count + 1] = 0
    for n in range(len(points)):
        starts[place(points[n], corner, cell, shape) + 1] += 1
    for c in range(count):
        starts[c + 1] += starts[c]
    for n in range(len(points)):  # each cell's start runs to its end, which is the next one's start
        c = place(points[n], corner, cell, shape)
        order[starts[c]] = n
        starts[c] += 1
    for c in range(count, 0, -1):
        starts[c] = starts[c - 1]
    starts[0] = 0
    return cell, count


@njit(
    "Tuple((i8, i8, f8, f8))(f8[:,::1], f8[::1], f8[:,::1], f8[::1], i4[::1], i4[::1], f8[::1], i8[::1], f8, f8, f8,"
    " f8)",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def match(
    asking: Array,
    asking_costs: Array,
    points: Array,
    point_costs: Array,
    starts: Index32,
    order: Index32,
    corner: Array,
    shape: Index,
    cell: float,
    tolerance: float,
    best: float,
    best_square: float,
) -> tuple[int, int, float, float]:
    """Returns the pair, asking row and point, of least cost within the tolerance, the nearer between equals.

    Only pairs better than cost `best` and squared distance `best_square` count; (-1, -1) if there is none. Returned
    too are the best pair's cost and squared distance.
    """
    least = np.inf
    for n in range(len(points)):
        least = min(least, point_costs[n])
    first, second = -1, -1
    limit = tolerance * tolerance
    for q in range(len(asking)):
        if asking_costs[q] + least > best:
            continue
        ux = (asking[q, 0] - corner[0]) / cell - 0.5
        uy = (asking[q, 1] - corner[1]) / cell - 0.5
        uz = (asking[q, 2] - corner[2]) / cell - 0.5
        if not (-1.0 <= ux < shape[0] and -1.0 <= uy < shape[1] and -1.0 <= uz < shape[2]):
            continue
        cx, cy, cz = int(np.floor(ux)), int(np.floor(uy)), int(np.floor(uz))
        for iz in range(max(cz, 0), min(cz + 2, shape[2])):
            for iy in range(max(cy, 0), min(cy + 2, shape[1])):
                row = (iz * shape[1] + iy) * shape[0]
                # Cells of a row lie one after the other, so their points do.
                for k in range(starts[row + max(cx, 0)], starts[row + min(cx + 2, shape[0])]):
                    n = order[k]
                    cost = asking_costs[q] + point_costs[n]
                    if cost > best:
                        continue
                    dx, dy, dz = asking[q, 0] - points[n, 0], asking[q, 1] - points[n, 1], asking[q, 2] - points[n, 2]
                    square = dx * dx + dy * dy + dz * dz
                    if square <= limit and (cost < best or square < best_square):
                        first, second, best, best_square = q, n, cost, square
    return first, second, best, best_square


@njit(
    "i8(f8[:,::1], f8[::1], f8[:,::1], f8[::1], i4[::1], i4[::1], f8[::1], i8[::1], f8, f8, i8[:,::1], f8[::1])",
    cache=True,
    nogil=True,
    error_model="numpy",
)
def collect(
    asking: Array,
    asking_costs: Array,
    points: Array,
    point_costs: Array,
    starts: Index32,
    order: Index32,
    corner: Array,
    shape: Index,
    cell: float,
    tolerance: float,
    pairs: Index,
    pair_costs: Array,
) -> int:
    """Writes the cheapest pairs within the tolerance, and their costs, as many as there is room for.

    Returns their number; `pairs` is of shape (n, 2), `pair_costs` of shape (n,).
    """
    count, room, worst, limit = 0, len(pair_costs), np.inf, tolerance * tolerance
    for q in range(len(asking)):
        if asking_costs[q] > worst:
            continue
        ux = (asking[q, 0] - corner[0]) / cell - 0.5
        uy = (asking[q, 1] - corner[1]) / cell - 0.5
        uz = (asking[q, 2] - corner[2]) / cell - 0.5
        if not (-1.0 <= ux < shape[0] and -1.0 <= uy < shape[1] and -1.0 <= uz < shape[2]):
            continue
        cx, cy, cz = int(np.floor(ux)), int(np.floor(uy)), int(np.floor(uz))
        for iz in range(max(cz, 0), min(cz + 2, shape[2])):
            for iy in range(max(cy, 0), min(cy + 2, shape[1])):
                row = (iz * shape[1] + iy) * shape[0]
                for k in range(starts[row + max(cx, 0)], starts[row + min(cx + 2, shape[0])]):
                    n = order[k]
                    cost = asking_costs[q] + point_costs[n]
                    if cost > worst or (count == room and cost == worst):
                        continue
                    dx, dy, dz = asking[q, 0] - points[n, 0], asking[q, 1] - points[n, 1], asking[q, 2] - points[n, 2]
                    if dx * dx + dy * dy + dz * dz > limit:
                        continue
                    at = count
                    if count == room:  # the dearest gives way
                        at = int(np.argmax(pair_costs))
                    else:
                        count += 1
                    pairs[at, 0], pairs[at, 1], pair_costs[at] = q, n, cost
                    if count == room:
                        worst = pair_costs.max()
    return count
