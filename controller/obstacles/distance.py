"""Distances of points, line segments and bodies from an obstacle, see Obstacles.

A signed distance is negative inside. It changes by at most the distance that the point moves. So a ball is clear of an
obstacle if its centre is farther away than its radius. The distance of a line segment from an obstacle is a closed
form. The squared distance from a box along the segment is a convex, piecewise quadratic function. Its pieces meet where
the segment crosses the planes of the box's faces.
"""

from typing import NamedTuple

import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, I1, UNCOUNTED, named

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SPHERE, BOX, HALF_SPACE = 0, 1, 2


class Surroundings(NamedTuple):
    """What bodies must not touch, for kernels."""

    kinds: Index  # see Obstacles
    axes: Array  # see Obstacles
    centres: Array  # see Obstacles
    sizes: Array  # see Obstacles
    margin: float  # distance from an obstacle that counts as touching
    apart: float  # distance between modules that counts as touching; negative without self-collision


SURROUNDINGS = named(Surroundings, I1, F3, F2, F2, float64, float64)


@kernel("f8(i8, f8[:,::1], f8[::1], f8[::1], f8, f8, f8)", **UNCOUNTED, error_model="numpy")
def signed_distance(kind: int, axes: Array, centre: Array, size: Array, x: float, y: float, z: float) -> float:
    """Returns the signed distance of a point from an obstacle, negative inside."""
    x, y, z = x - centre[0], y - centre[1], z - centre[2]
    if kind == SPHERE:
        return float(np.sqrt(x * x + y * y + z * z) - size[0])
    if kind == HALF_SPACE:
        return float(axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z)
    square, deepest = 0.0, -np.inf
    for a in range(3):
        over = abs(axes[a, 0] * x + axes[a, 1] * y + axes[a, 2] * z) - size[a]
        square += max(over, 0.0) ** 2
        deepest = max(deepest, over)
    return float(np.sqrt(square) if deepest > 0 else deepest)


@kernel("f8(f8[::1], UniTuple(f8, 3), UniTuple(f8, 3), f8)", **UNCOUNTED, inline="always")
def slope(half: Array, start: tuple[float, ...], way: tuple[float, ...], t: float) -> float:
    """Returns half the derivative of the squared distance from a box along a line, in the frame of the box."""
    total = 0.0
    for a in range(3):
        at = start[a] + t * way[a]
        if at > half[a]:
            total += (at - half[a]) * way[a]
        elif at < -half[a]:
            total += (at + half[a]) * way[a]
    return total


@kernel("f8(f8[::1], UniTuple(f8, 3), UniTuple(f8, 3))", **UNCOUNTED, error_model="numpy")
def nearest_to_box(half: Array, start: tuple[float, ...], way: tuple[float, ...]) -> float:
    """Returns the place on a segment that is nearest to a box, from 0 at its start to 1 at its end."""
    low, high = 0.0, 1.0
    falling, rising = slope(half, start, way, low), slope(half, start, way, high)
    if falling >= 0:
        return low
    if rising <= 0:
        return high
    for a in range(3):
        if way[a] != 0:
            for side in (-half[a], half[a]):
                t = (side - start[a]) / way[a]
                if low < t < high:
                    at = slope(half, start, way, t)
                    if at == 0:
                        return float(t)
                    if at > 0:
                        high, rising = t, at
                    else:
                        low, falling = t, at
    # Between these places the segment crosses no face, so the slope is linear there.
    return float(low - (high - low) * falling / (rising - falling))


@kernel(
    "f8(i8, f8[:,::1], f8[::1], f8[::1], UniTuple(f8, 3), UniTuple(f8, 3))",
    **UNCOUNTED,
    error_model="numpy",
)
def segment_distance(
    kind: int, axes: Array, centre: Array, size: Array, start: tuple[float, ...], end: tuple[float, ...]
) -> float:
    """Returns the distance between a line segment and an obstacle, 0 if they meet."""
    x, y, z = start[0] - centre[0], start[1] - centre[1], start[2] - centre[2]
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    if kind == HALF_SPACE:
        here = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
        change = axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz
        return float(max(here + min(change, 0.0), 0.0))
    if kind == SPHERE:
        square, t = dx * dx + dy * dy + dz * dz, 0.0
        if square > 0:
            t = min(max(-(x * dx + y * dy + z * dz) / square, 0.0), 1.0)
        x, y, z = x + t * dx, y + t * dy, z + t * dz
        return float(max(np.sqrt(x * x + y * y + z * z) - size[0], 0.0))
    seen = (
        axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z,
        axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z,
        axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z,
    )
    way = (
        axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz,
        axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz,
        axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz,
    )
    t, square = nearest_to_box(size, seen, way), 0.0
    for a in range(3):
        square += max(abs(seen[a] + t * way[a]) - size[a], 0.0) ** 2
    return float(np.sqrt(square))


@kernel("UniTuple(f8, 3)(f8[:,::1], f8[::1], f8[::1])", **UNCOUNTED)
def placed(r: Array, b: Array, point: Array) -> tuple[float, float, float]:
    """Returns b + R p."""
    x, y, z = point[0], point[1], point[2]
    return (
        b[0] + r[0, 0] * x + r[0, 1] * y + r[0, 2] * z,
        b[1] + r[1, 0] * x + r[1, 1] * y + r[1, 2] * z,
        b[2] + r[2, 0] * x + r[2, 1] * y + r[2, 2] * z,
    )


@kernel(
    int64(F2, F1, F3, F1, SURROUNDINGS, float64),
    **UNCOUNTED,
    error_model="numpy",
)
def first_obstacle(r: Array, b: Array, body: Array, ball: Array, surroundings: Surroundings, radius: float) -> int:
    """Returns the first obstacle at most `radius` away from a body, -1 for none.

    The body's frame has rotation `r` (3, 3) and position `b` (3,) in the world. In this frame the body is line segments
    (L, 2, 3), in a ball of a centre and radius (4,).
    """
    kinds, axes, centres, sizes, _, _ = surroundings
    if len(kinds) == 0:
        return -1
    middle = placed(r, b, ball[:3])
    for k in range(len(kinds)):
        if signed_distance(kinds[k], axes[k], centres[k], sizes[k], middle[0], middle[1], middle[2]) > radius + ball[3]:
            continue
        for n in range(len(body)):
            start, end = placed(r, b, body[n, 0]), placed(r, b, body[n, 1])
            if segment_distance(kinds[k], axes[k], centres[k], sizes[k], start, end) <= radius:
                return k
    return -1
