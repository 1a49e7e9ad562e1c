"""Checks whether a configuration solves a goal: forward kinematics of the arm, and distances from obstacles.

Written for the proofs: it uses from the product only the modules' frames and bodies, and the obstacles' numbers.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.distance import BOX, HALF_SPACE, SPHERE

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Check(NamedTuple):
    """The requirements on a configuration.

    Attributes:
        base: frame F_0 in the world, shape (4, 4).
        frames: of the modules' states, shape (B, K, 4, 4).
        goal: frame in the world, shape (4, 4).
        turn: tolerance of the angle about z [rad]; infinite: any angle.
        bodies: line segments of the modules' states, padded with the first one, shape (B, K, L, 2, 3).
        kinds: of the obstacles, shape (n,); see hyperbit.controller.obstacles.
        axes: rows are those of boxes, the first is a half-space's normal, shape (n, 3, 3).
        centres: shape (n, 3).
        sizes: radius in the first place, or half the sides of a box, shape (n, 3).
        margin: least distance of a body's line from an obstacle without collision.
    """

    base: Array
    frames: Array
    goal: Array
    tolerance: float
    turn: float
    bodies: Array
    kinds: Index
    axes: Array
    centres: Array
    sizes: Array
    margin: float


def check_of(clearance: BodyClearance, goal: Array, tolerance: float, turn: float) -> Check:
    """Returns the requirements of a goal on an arm's configurations.

    Raises:
        ValueError: this module cannot check a kind of obstacle, or self-collision.
    """
    m, regions = clearance.manipulator, clearance.obstacles
    if clearance.self_collision or (not m.planar and (regions.kinds == BOX).any()):
        raise ValueError("self-collision, and boxes in space, are not checked here")
    most = max(module.body.shape[1] for module in m.modules)
    bodies = np.zeros((*m.frames.shape[:2], most, 2, 3))
    for i, module in enumerate(m.modules):
        some = module.body.shape[1]
        bodies[i, : len(module.body), :some] = module.body
        bodies[i, : len(module.body), some:] = module.body[:, :1]
    goal = np.ascontiguousarray(goal, dtype=float)
    frames, numbers = np.ascontiguousarray(m.frames), (float(tolerance), float(turn))
    shapes = (regions.kinds, regions.axes, regions.centres, regions.sizes)
    return Check(m.base, frames, goal, *numbers, bodies, *shapes, clearance.margin)


@njit(cache=True, nogil=True)
def accepted(check: Check, configuration: Index) -> bool:
    """Returns whether a configuration (B,) is within the tolerances and collision-free."""
    frame, following = check.base.copy(), np.empty((4, 4))
    for i in range(len(configuration)):
        own = check.frames[i, configuration[i]]
        for a in range(4):
            for b in range(4):
                total = 0.0
                for c in range(4):
                    total += frame[a, c] * own[c, b]
                following[a, b] = total
        frame, following = following, frame
    dx, dy, dz = frame[0, 3] - check.goal[0, 3], frame[1, 3] - check.goal[1, 3], frame[2, 3] - check.goal[2, 3]
    if np.sqrt(dx * dx + dy * dy + dz * dz) > check.tolerance:
        return False
    if check.turn < np.pi:
        sine = check.goal[0, 0] * frame[1, 0] - check.goal[1, 0] * frame[0, 0]
        cosine = check.goal[0, 0] * frame[0, 0] + check.goal[1, 0] * frame[1, 0]
        if abs(np.arctan2(sine, cosine)) > check.turn:
            return False
    return len(check.kinds) == 0 or clear(check, configuration)


@njit(cache=True, nogil=True)
def clear(check: Check, configuration: Index) -> bool:
    """Returns whether no body of a configuration (B,) touches an obstacle."""
    frame = check.base.copy()
    ends = np.empty((2, 3))
    for i in range(len(configuration)):
        state = configuration[i]
        for line in range(check.bodies.shape[2]):
            for side in range(2):
                for a in range(3):
                    ends[side, a] = frame[a, 3]
                    for b in range(3):
                        ends[side, a] += frame[a, b] * check.bodies[i, state, line, side, b]
            for k in range(len(check.kinds)):
                if gap(check, k, ends) <= check.margin:
                    return False
        frame = frame @ check.frames[i, state]
    return True


@njit(cache=True, nogil=True)
def gap(check: Check, k: int, ends: Array) -> float:
    """Returns the distance of a line segment (2, 3) from an obstacle; 0 or less if they meet."""
    if check.kinds[k] == SPHERE:
        return away(ends[0], ends[1], check.centres[k]) - check.sizes[k, 0]
    if check.kinds[k] == HALF_SPACE:
        first = np.sum(check.axes[k, 0] * (ends[0] - check.centres[k]))
        return min(first, np.sum(check.axes[k, 0] * (ends[1] - check.centres[k])))
    # A box in the plane, seen from its own axes.
    half, own = check.sizes[k], np.zeros((2, 3))
    for side in range(2):
        for a in range(2):
            own[side, a] = np.sum(check.axes[k, a] * (ends[side] - check.centres[k]))
    if crosses(own, half):
        return 0.0
    least = np.inf
    for side in range(2):
        beyond = 0.0
        for a in range(2):
            beyond += max(abs(own[side, a]) - half[a], 0.0) ** 2
        least = min(least, np.sqrt(beyond))
    corner = np.zeros(3)
    for sx in (-1.0, 1.0):
        for sy in (-1.0, 1.0):
            corner[0], corner[1] = sx * half[0], sy * half[1]
            least = min(least, away(own[0], own[1], corner))
    return least


@njit(cache=True, nogil=True)
def away(first: Array, second: Array, point: Array) -> float:
    """Returns the distance of a point (3,) from a line segment."""
    along = second - first
    length = np.sum(along * along)
    share = 0.0 if length == 0.0 else min(max(np.sum((point - first) * along) / length, 0.0), 1.0)
    return np.sqrt(np.sum((first + share * along - point) ** 2))


@njit(cache=True, nogil=True)
def crosses(own: Array, half: Array) -> bool:
    """Returns whether a line segment (2, 3) meets the rectangle |x| <= half[0], |y| <= half[1]: by clipping."""
    enter, leave = 0.0, 1.0
    for a in range(2):
        step = own[1, a] - own[0, a]
        for sign in (-1.0, 1.0):
            room, speed = half[a] - sign * own[0, a], sign * step
            if speed == 0.0:
                if room < 0.0:
                    return False
            elif speed > 0.0:
                leave = min(leave, room / speed)
            else:
                enter = max(enter, room / speed)
    return enter <= leave
