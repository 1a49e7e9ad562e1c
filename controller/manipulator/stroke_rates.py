"""Proven bounds on what strokes do: how fast each moves the frame above, turns it, and moves the body.

Each function returns bounds (k, 3) for the actuators that move, over all their strokes from 0 to 1 together, in units
of length, radian and length for a whole stroke. They are closed forms, not samples. By the mean value theorem two poses
differ by no more than the bounds times the differences of the strokes. A bound is infinite where a module has no state.
"""

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bits = NDArray[np.uint8]

WIDEST = 0.999 * math.pi / 2  # angle between unit quaternions from which the shorter way may change


def corner_states(bits: Bits, fixed: Array, moving: Index) -> Index | None:
    """Returns the states (2^k,) that moving actuators spell, the first the most significant; None if one is missing."""
    corners = np.tile(fixed, (1 << len(moving), 1))
    corners[:, moving] = list(product((0.0, 1.0), repeat=len(moving)))
    same = (bits == corners[:, None]).all(axis=2)
    return same.argmax(axis=1) if same.any(axis=1).all() else None


def multilinear_rates(values: Array) -> Array:
    """Returns the greatest rate (k,) along each stroke of vectors between corners (2^k, m, d), linear in each stroke.

    A rate is linear in the other strokes, so its norm is greatest at a corner.
    """
    k = len(values).bit_length() - 1
    grid = values.reshape(*[2] * k, *values.shape[1:])
    return np.array([np.linalg.norm(np.diff(grid, axis=a), axis=-1).max() for a in range(k)])


def joint_rates(bits: Bits, values: Array, move: float, turn: float, fixed: Array, moving: Index) -> Array:
    """Returns the bounds of a joint, whose value is linear in each stroke.

    Args:
        bits: actuator states of its positions, shape (K, A).
        values: of its positions, shape (K,).
        move: how far the frame above moves for a unit of the value.
        turn: how far it turns.
        fixed: strokes of the actuators that stay, shape (A,).
        moving: those that move, shape (k,).
    """
    if (states := corner_states(bits, fixed, moving)) is None:
        return np.full((len(moving), 3), np.inf)
    return multilinear_rates(values[states][:, None, None])[:, None] * (move, turn, move)


def truss_rates(first: Array, diagonal: Array, second: Array, width: float) -> Array:
    """Returns bounds (3, 3) of a truss for its first leg, diagonal and second leg, for a unit of length.

    The first leg and the diagonal meet in the first apex, at an angle g. If one of them grows, the apex moves square to
    the other, at a rate of 1 / sin g. The second leg and the top, of fixed length, meet in the second apex at an angle
    d. This apex moves square to the second leg, and as far along the top as the first apex does: at most
    1 / (sin g sin d). The top turns at |v . u| / (width sin d), v being the first apex's velocity and u the direction
    of the second leg: by the law of sines 1 / (diagonal sin g) for the first leg. For the diagonal it is
    |sin(g - b)| / (width sin g sin d), b being the angle between diagonal and second leg. If the second leg grows, the
    first apex stays, the second moves at 1 / sin d, and the top turns at 1 / (width sin d).

    As functions of each length the cosines have no maximum inside an interval, and no minimum below 0: their absolute
    values are greatest at corners.

    Args:
        first: least and greatest length of the leg that ends in the first apex, shape (2,).
        diagonal: likewise.
        second: likewise of the leg that ends in the second apex.
        width: of base and top.
    """
    lower = max(abs(f * f + m * m - width**2) / (2 * f * m) for f, m in product(first, diagonal))
    upper = max(abs(width**2 + s * s - m * m) / (2 * width * s) for s, m in product(second, diagonal))
    if lower >= 1 or upper >= 1:
        return np.full((3, 3), np.inf)
    near, far = 1 / math.sqrt(1 - lower**2), 1 / math.sqrt(1 - upper**2)
    (g_low, g_high), (b_low, b_high) = apex_angles(first, diagonal, width), apex_angles(second, diagonal, width)
    slant = math.sin(min(max(g_high - b_low, b_high - g_low, 0.0), math.pi / 2))
    move, turn = (near + near * far) / 2, near / float(diagonal.min())
    by_diagonal = (move, near * far * slant / width, near * far)
    return np.array([(move, turn, near * far), by_diagonal, (far / 2, far / width, far)])


def apex_angles(leg: Array, diagonal: Array, width: float) -> tuple[float, float]:
    """Returns the least and greatest angle between a leg and the diagonal of a triangle over a side of a width.

    The cosine's extremes are at corners, or where its derivative by one length is 0 and the other is at an end.
    """
    pairs = list(product(leg.tolist(), diagonal.tolist()))
    for ends, others, swap in ((leg, diagonal, False), (diagonal, leg, True)):
        for end in ends.tolist():
            flat = math.sqrt(max(end**2 - width**2, 0.0))
            if others.min() < flat < others.max():
                pairs.append((flat, end) if swap else (end, flat))
    angles = [math.acos(min(max((a * a + b * b - width**2) / (2 * a * b), -1.0), 1.0)) for a, b in pairs]
    return min(angles), max(angles)


def blended_rates(positions: Array, turns: Array, bodies: Array) -> Array:
    """Returns bounds of frames between corners: positions and bodies go straight, rotations by nested slerp.

    On the sphere of unit quaternions slerp's point moves no faster than the faster of its ends over the cosine of half
    the angle between them. That angle is bounded by what it is in the middle of all strokes, and by the ends' rates.

    Args:
        positions: of the corners, shape (2^k, 3).
        turns: their unit quaternions, shape (2^k, 4).
        bodies: their line segments, shape (2^k, L, 2, 3).
    """
    k = len(positions).bit_length() - 1
    rates = np.zeros((len(turns), k))
    for a in range(k):
        (first, second), (one, other) = np.split(turns, 2), np.split(rates, 2)
        cosines = (first * second).sum(axis=1)
        angles = np.arccos(np.clip(abs(cosines), 0.0, 1.0)) + (one + other).sum(axis=1) / 2
        if angles.max() >= WIDEST:
            return np.full((k, 3), np.inf)
        middle = first + np.where(cosines < 0, -1.0, 1.0)[:, None] * second
        turns = middle / np.linalg.norm(middle, axis=1, keepdims=True)
        rates = np.maximum(one, other) / np.cos(angles / 2)[:, None]
        rates[:, a] = angles
    bounds = (
        multilinear_rates(positions[:, None]),
        2 * rates[0],
        multilinear_rates(bodies.reshape(len(bodies), -1, 3)),
    )
    return np.column_stack(bounds)
