"""Proven bounds on a module in mid-travel: translation and rotation of its top frame, and movement of its body.

A displacement is 0 for a contracted actuator and 1 for an extended one. Each function returns bounds (k, 3) for the k
moving actuators, over all their displacements. The units are length, radian and length for a displacement from 0 to 1.
The bounds are closed forms, not samples. By the mean value theorem two poses differ by at most the bounds times the
differences of the displacements. A bound is infinite if the module lacks a state.
"""

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bits = NDArray[np.uint8]

WIDEST = 0.999 * math.pi / 2  # greatest angle between unit quaternions; beyond it the shorter way may change


def corner_states(bits: Bits, fixed: Array, moving: Index) -> Index | None:
    """Returns the states (2^k,) with each moving actuator at either end, the first most significant.

    Returns None if the module has no such state for one of them.
    """
    corners = np.tile(fixed, (1 << len(moving), 1))
    corners[:, moving] = list(product((0.0, 1.0), repeat=len(moving)))
    same = (bits == corners[:, None]).all(axis=2)
    return same.argmax(axis=1) if same.any(axis=1).all() else None


def multilinear_rates(values: Array) -> Array:
    """Returns the greatest rate (k,) along each displacement of multilinear vectors between corners (2^k, m, d).

    A rate is linear in each other displacement, so its norm is greatest at a corner.
    """
    k = len(values).bit_length() - 1
    grid = values.reshape(*[2] * k, *values.shape[1:])
    return np.array([np.linalg.norm(np.diff(grid, axis=a), axis=-1).max() for a in range(k)])


def joint_rates(bits: Bits, values: Array, move: float, turn: float, fixed: Array, moving: Index) -> Array:
    """Returns the bounds of a joint. Its value is multilinear in the displacements.

    Args:
        bits: actuator states of its positions, shape (K, A).
        values: angle [rad] or length of each position, shape (K,).
        move: translation of the frame above for a unit of the value.
        turn: rotation of the frame above for a unit of the value [rad].
        fixed: displacements of the actuators that do not move, shape (A,).
        moving: numbers of the actuators that move, shape (k,).
    """
    if (states := corner_states(bits, fixed, moving)) is None:
        return np.full((len(moving), 3), np.inf)
    return multilinear_rates(values[states][:, None, None])[:, None] * (move, turn, move)


def truss_rates(first: Array, diagonal: Array, second: Array, width: float) -> Array:
    """Returns the bounds (3, 3) of a truss per unit of length, for its first leg, diagonal and second leg.

    The first leg and the diagonal meet in the first apex, at an angle g. If one of them grows, the apex moves normal to
    the other, at a rate of 1 / sin g. The second leg and the top, of fixed length, meet in the second apex at an angle
    d. The second apex moves normal to the second leg. Along the top it moves as far as the first apex: at most
    1 / (sin g sin d). The top turns at |v . u| / (width sin d). Here v is the velocity of the first apex, and u is the
    direction of the second leg. By the law of sines this is 1 / (diagonal sin g) for the first leg. For the diagonal it
    is |sin(g - b)| / (width sin g sin d), where b is the angle between diagonal and second leg. If the second leg
    grows, the first apex does not move, the second moves at 1 / sin d, and the top turns at 1 / (width sin d).

    As a function of each length, a cosine has no maximum inside an interval and no minimum below 0. So its absolute
    value is greatest at a corner.

    Args:
        first: least and greatest length of the leg to the first apex, shape (2,).
        diagonal: least and greatest length, shape (2,).
        second: least and greatest length of the leg to the second apex, shape (2,).
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
    """Returns the least and greatest angle [rad] between leg and diagonal of a triangle whose third side is `width`.

    The cosine is extreme at a corner, or where one length is at an end and the derivative by the other is 0.
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
    """Returns the bounds of a blend: positions and bodies are multilinear, rotations are nested slerps.

    On the sphere of unit quaternions, the rate of a slerp is at most the rate of its faster end, divided by the cosine
    of half the angle between the ends. This angle is at most the angle in the middle of all displacements, plus what
    the rates of the ends add.

    Args:
        positions: positions of the corners, shape (2^k, 3).
        turns: unit quaternions of the corners, shape (2^k, 4).
        bodies: line segments of the corners, shape (2^k, L, 2, 3).
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
