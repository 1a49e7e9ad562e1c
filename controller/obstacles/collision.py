"""The first collision of a configuration, from base to tip, with an obstacle or between two modules."""

import numpy as np
from numba import njit

from controller.manipulator.frame_kernels import compose
from controller.obstacles.distance import Array, Index, first_obstacle, placed


@njit("f8(f8[:,::1], f8[:,::1])", cache=True, nogil=True, error_model="numpy")
def lines_distance(first: Array, second: Array) -> float:
    """Returns the distance between two line segments (2, 3).

    The nearest points of the two straight lines are clamped to the segments (Ericson 2004, Real-Time Collision
    Detection, section 5.1.9).
    """
    along, across, both, ahead, aside = 0.0, 0.0, 0.0, 0.0, 0.0
    for a in range(3):
        u, v, w = first[1, a] - first[0, a], second[1, a] - second[0, a], first[0, a] - second[0, a]
        along += u * u
        across += v * v
        both += u * v
        ahead += u * w
        aside += v * w
    s = 0.0
    parallel = along * across - both * both
    if parallel > 0:
        s = min(max((both * aside - ahead * across) / parallel, 0.0), 1.0)
    t = (both * s + aside) / across if across > 0 else 0.0
    if across <= 0 or not 0 <= t <= 1:
        t = min(max(t, 0.0), 1.0)
        s = min(max((both * t - ahead) / along, 0.0), 1.0) if along > 0 else 0.0
    square = 0.0
    for a in range(3):
        u, v, w = first[1, a] - first[0, a], second[1, a] - second[0, a], first[0, a] - second[0, a]
        square += (w + s * u - t * v) ** 2
    return float(np.sqrt(square))


@njit("i8(f8[:,:,:,::1], f8[:,::1], i8[::1], i8, f8)", cache=True, nogil=True)
def first_module(ends: Array, middles: Array, lines: Index, i: int, apart: float) -> int:
    """Returns the first module at most `apart` away from module i, without its neighbours; -1 if there is none.

    Args:
        ends: line segments in the world, shape (B, Lmax, 2, 3).
        middles: centres and radii of balls around them, shape (B, 4).
        lines: number of line segments of each module, shape (B,).
        i: the module; only modules below it are compared.
        apart: distance that counts as touching.
    """
    for j in range(i - 1):
        square = 0.0
        for a in range(3):
            square += (middles[i, a] - middles[j, a]) ** 2
        if square > (middles[i, 3] + middles[j, 3] + apart) ** 2:
            continue
        for m in range(lines[i]):
            for n in range(lines[j]):
                if lines_distance(ends[i, m], ends[j, n]) <= apart:
                    return j
    return -1


@njit(
    "i8[:,::1](f8[:,::1], f8[::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,:,:,::1], f8[:,:,::1], i8[::1],"
    " i8[::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8, f8, i8[:,::1])",
    cache=True,
    nogil=True,
)
def first_collisions(
    base_r: Array,
    base_b: Array,
    rotations: Array,
    translations: Array,
    bodies: Array,
    ball_table: Array,
    lines: Index,
    kinds: Index,
    axes: Array,
    centres: Array,
    sizes: Array,
    margin: float,
    apart: float,
    configurations: Index,
) -> Index:
    """Returns the first collision of each configuration, shape (n, 3).

    A row has the module, the obstacle that it touches, and the other module that it touches; -1 for none.

    Args:
        base_r: rotation of frame F_0 in the world, shape (3, 3).
        base_b: position of frame F_0 in the world, shape (3,).
        rotations: configuration sets, shape (B, Kmax, 3, 3).
        translations: configuration sets, shape (B, Kmax, 3).
        bodies: see Clearance.
        ball_table: see `balls` of Clearance.
        lines: see Clearance.
        kinds: see Obstacles.
        axes: see Obstacles.
        centres: see Obstacles.
        sizes: see Obstacles.
        margin: distance from an obstacle that counts as touching.
        apart: distance between modules that counts as touching; negative without self-collision.
        configurations: shape (n, B).
    """
    n, modules = configurations.shape
    result = np.full((n, 3), -1)
    r, b = np.empty((3, 3)), np.empty(3)
    ends, middles = np.empty((modules, bodies.shape[2], 2, 3)), np.empty((modules, 4))
    for c in range(n):
        for a in range(3):
            b[a] = base_b[a]
            for d in range(3):
                r[a, d] = base_r[a, d]
        for i in range(modules):
            state = configurations[c, i]
            ball, body = ball_table[i, state], bodies[i, state, : lines[i]]
            obstacle = first_obstacle(r, b, body, ball, kinds, axes, centres, sizes, margin)
            if obstacle >= 0:
                result[c, 0], result[c, 1] = i, obstacle
                break
            if apart >= 0:
                for line in range(lines[i]):
                    for side in range(2):
                        x, y, z = placed(r, b, body[line, side])
                        ends[i, line, side, 0], ends[i, line, side, 1], ends[i, line, side, 2] = x, y, z
                x, y, z = placed(r, b, ball[:3])
                middles[i, 0], middles[i, 1], middles[i, 2], middles[i, 3] = x, y, z, ball[3]
                other = first_module(ends, middles, lines, i, apart)
                if other >= 0:
                    result[c, 0], result[c, 2] = i, other
                    break
            compose(r, b, rotations[i, state], translations[i, state], r, b)
    return result
