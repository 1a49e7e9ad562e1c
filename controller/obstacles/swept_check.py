"""Proves by bounds that a transition is clear: the kernel.

The displacements of the moving actuators form a box, which is checked in parts. In a part of the box, a moving module
translates and rotates all modules above it. A point of theirs moves by at most the translation plus the rotation times
the point's distance from the module's top frame. The bounds of all modules below a body add up: each bound holds with
the modules above in the middle of the box, and the modules below only move the whole rigidly. A body that is farther
from an obstacle than the sum of its bounds, in the middle of the box, is clear in the whole box.
"""

import numpy as np
from numba import njit

from controller.manipulator.frame_kernels import compose
from controller.obstacles.collision import lines_distance
from controller.obstacles.distance import Array, Index, first_obstacle, placed

CLEAR, COLLIDING = -1, -2


@njit("f8(f8[:,::1], f8[::1], f8[:,:,::1], f8[:,::1], f8[::1], f8[:,:,::1])", cache=True, nogil=True)
def body_distance(r: Array, b: Array, body: Array, s: Array, c: Array, other: Array) -> float:
    """Returns the distance between two bodies (L, 2, 3) in frames (r, b) and (s, c)."""
    least, first, second = np.inf, np.empty((2, 3)), np.empty((2, 3))
    for m in range(len(body)):
        for side in range(2):
            first[side, 0], first[side, 1], first[side, 2] = placed(r, b, body[m, side])
        for n in range(len(other)):
            for side in range(2):
                second[side, 0], second[side, 1], second[side, 2] = placed(s, c, other[n, side])
            least = min(least, lines_distance(first, second))
    return least


@njit("f8(f8, f8, f8, f8[::1])", cache=True, nogil=True, inline="always")
def away(x: float, y: float, z: float, point: Array) -> float:
    """Returns the distance between two points."""
    return float(np.sqrt((x - point[0]) ** 2 + (y - point[1]) ** 2 + (z - point[2]) ** 2))


@njit(
    "i8[::1](f8[:,:,:,::1], f8[:,:,::1], f8[:,:,:,:,::1], f8[:,:,::1], i8[::1], i8[::1], f8[:,::1], f8[:,::1],"
    " i8[::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8, f8, b1[:,::1], i8[:,::1])",
    cache=True,
    nogil=True,
)
def swept_check(
    rotations: Array,
    translations: Array,
    bodies: Array,
    balls: Array,
    lines: Index,
    owners: Index,
    rates: Array,
    half_widths: Array,
    kinds: Index,
    axes: Array,
    centres: Array,
    sizes: Array,
    margin: float,
    apart: float,
    suspects: Array,
    reports: Index,
) -> Index:
    """Returns for each box of displacements CLEAR, COLLIDING (in its middle), or the actuator along which to cut it.

    Args:
        rotations: of the base and of every module in the middle of each box, shape (n, B + 1, 3, 3).
        translations: likewise, shape (n, B + 1, 3).
        bodies: line segments of every module there, shape (n, B, Lmax, 2, 3).
        balls: centres and radii of balls around them, shape (n, B, 4).
        lines: number of line segments of each module, shape (B,).
        owners: module of each actuator that switches, shape (k,).
        rates: see Displacements.rates, shape (k, 3).
        half_widths: half the width of each box along each displacement, shape (n, k).
        kinds: see Obstacles.
        axes: see Obstacles.
        centres: see Obstacles.
        sizes: see Obstacles.
        margin: see Clearance.
        apart: see Clearance.
        suspects: modules to check, shape (n, B); the kernel clears those that it proves clear.
        reports: written: module, obstacle and other module of a possible collision, shape (n, 3).
    """
    n, modules, k = len(bodies), bodies.shape[1], len(owners)
    result = np.full(n, CLEAR)
    r, b = np.empty((modules + 1, 3, 3)), np.empty((modules + 1, 3))
    moves, turns, swells = np.empty(modules), np.empty(modules), np.empty(modules)
    for box in range(n):
        moves[:], turns[:], swells[:] = 0.0, 0.0, 0.0
        for a in range(k):
            moves[owners[a]] += half_widths[box, a] * rates[a, 0]
            turns[owners[a]] += half_widths[box, a] * rates[a, 1]
            swells[owners[a]] += half_widths[box, a] * rates[a, 2]
        for c in range(3):
            b[0, c] = translations[box, 0, c]
            for d in range(3):
                r[0, c, d] = rotations[box, 0, c, d]
        for i in range(modules):
            compose(r[i], b[i], rotations[box, i + 1], translations[box, i + 1], r[i + 1], b[i + 1])
        greatest, worst, lowest = -1.0, -1, 0
        for j in range(modules):
            if not suspects[box, j]:
                continue
            body, ball = bodies[box, j, : lines[j]], balls[box, j]
            x, y, z = placed(r[j], b[j], ball[:3])
            obstacle, other, swept, low = -1, -1, swells[j], 0
            for i in range(j):
                if turns[i] > 0 or moves[i] > 0:
                    swept += moves[i] + turns[i] * (away(x, y, z, b[i + 1]) + ball[3])
            obstacle = first_obstacle(r[j], b[j], body, ball, kinds, axes, centres, sizes, margin + swept)
            collided = (
                obstacle >= 0 and first_obstacle(r[j], b[j], body, ball, kinds, axes, centres, sizes, margin) >= 0
            )
            if apart >= 0 and obstacle < 0:
                swept = swells[j]
                for i in range(j - 1, -1, -1):
                    if turns[i] > 0 or moves[i] > 0:
                        swept += moves[i] + turns[i] * (away(x, y, z, b[i + 1]) + ball[3])
                    near = apart + swept + swells[i]
                    u, v, w = placed(r[i], b[i], balls[box, i, :3])
                    point = np.array([u, v, w])
                    if i < j - 1 and away(x, y, z, point) <= ball[3] + balls[box, i, 3] + near:
                        gap = body_distance(r[j], b[j], body, r[i], b[i], bodies[box, i, : lines[i]])
                        if gap <= near:
                            other, low, collided = i, i, gap <= apart
                            swept += swells[i]
                            break
            suspects[box, j] = obstacle >= 0 or other >= 0
            if not suspects[box, j]:
                continue
            if collided or swept > greatest:
                greatest, worst, lowest = swept, j, low
                reports[box, 0], reports[box, 1], reports[box, 2] = j, obstacle, other
            if collided:
                result[box] = COLLIDING
                break
        if worst < 0 or result[box] == COLLIDING:
            continue
        x, y, z = placed(r[worst], b[worst], balls[box, worst, :3])
        most = -1.0
        for a in range(k):
            i = owners[a]
            if i < lowest or i > worst:
                continue
            share = rates[a, 2] if i == worst or (i == lowest and lowest > 0) else 0.0
            if i < worst:
                share += rates[a, 0] + rates[a, 1] * (away(x, y, z, b[i + 1]) + balls[box, worst, 3])
            if half_widths[box, a] * share > most:
                most, result[box] = half_widths[box, a] * share, a
    return result
