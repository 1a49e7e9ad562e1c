"""Proves by bounds that a transition is clear: the kernel.

The displacements of the moving actuators form a box, which is checked in parts. In a part of the box, a moving module
translates and rotates all modules above it. A point of theirs moves by at most the translation plus the rotation times
the point's distance from the module's top frame. The bounds of all modules below a body add up: each bound holds with
the modules above in the middle of the box, and the modules below only move the whole rigidly. A body that is farther
from an obstacle than the sum of its bounds, in the middle of the box, is clear in the whole box.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import boolean, float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.frame_kernels import compose
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, F4, F5, I1, I2, UNCOUNTED, named
from hyperbit.controller.obstacles.collision import lines_distance
from hyperbit.controller.obstacles.distance import SURROUNDINGS, Array, Index, Surroundings, first_obstacle, placed

Point = tuple[float, float, float]
Flags = NDArray[np.bool_]

CLEAR, COLLIDING = -1, -2


class Chains(NamedTuple):
    """The arm in the middle of n boxes of displacements."""

    rotations: Array  # of the base and of every module, shape (n, B + 1, 3, 3)
    translations: Array  # likewise, shape (n, B + 1, 3)
    bodies: Array  # line segments of every module, shape (n, B, Lmax, 2, 3)
    balls: Array  # centres and radii of balls around them, shape (n, B, 4)
    lines: Index  # number of line segments of each module, shape (B,)


class Switching(NamedTuple):
    owners: Index  # module of each actuator, shape (k,)
    rates: Array  # see Displacements.rates, shape (k, 3)
    half_widths: Array  # of each box along each displacement, shape (n, k)


class BoxMotion(NamedTuple):
    """Scratch: the arm in the middle of one box, and bounds on its motion in the box."""

    rotations: Array  # rotations of frames F_0 to F_B in the world, shape (B + 1, 3, 3)
    positions: Array  # positions of frames F_0 to F_B in the world, shape (B + 1, 3)
    moves: Array  # translation of each module's top frame, shape (B,)
    turns: Array  # rotation of each module's top frame, shape (B,)
    swells: Array  # movement of the points of each module's body, shape (B,)
    segments: Array  # two line segments in the world, shape (2, 2, 3)


CHAINS = named(Chains, F4, F3, F5, F3, I1)
SWITCHING = named(Switching, I1, F2, F2)
BOX_MOTION = named(BoxMotion, F3, F2, F1, F1, F1, F3)
POINT: Any = types.UniTuple(float64, 3)  # type: ignore[no-untyped-call]
NEAR: Any = types.Tuple((int64, float64, boolean))  # type: ignore[no-untyped-call]
WORST: Any = types.Tuple((int64, int64, boolean))  # type: ignore[no-untyped-call]


@kernel(float64(F2, F1, F3, F2, F1, F3, F3), **UNCOUNTED)
def body_distance(r: Array, b: Array, body: Array, s: Array, c: Array, other: Array, segments: Array) -> float:
    """Returns the distance of two bodies (L, 2, 3) in frames (r, b) and (s, c); `segments` (2, 2, 3) is scratch."""
    least, first, second = np.inf, segments[0], segments[1]
    for m in range(len(body)):
        for side in range(2):
            first[side, 0], first[side, 1], first[side, 2] = placed(r, b, body[m, side])
        for n in range(len(other)):
            for side in range(2):
                second[side, 0], second[side, 1], second[side, 2] = placed(s, c, other[n, side])
            least = min(least, lines_distance(first, second))
    return least


@kernel(float64(POINT, float64, float64, float64), **UNCOUNTED, inline="always")
def away(point: Point, x: float, y: float, z: float) -> float:
    return float(np.sqrt((point[0] - x) ** 2 + (point[1] - y) ** 2 + (point[2] - z) ** 2))


@kernel(float64(BOX_MOTION, int64, POINT, float64), **UNCOUNTED, inline="always")
def lever(motion: BoxMotion, i: int, middle: Point, radius: float) -> float:
    """Returns the greatest distance of a point of a ball from the top frame of module i."""
    positions = motion.positions
    return float(away(middle, positions[i + 1, 0], positions[i + 1, 1], positions[i + 1, 2]) + radius)


@kernel(float64(BOX_MOTION, int64, POINT, float64), **UNCOUNTED, inline="always")
def carried(motion: BoxMotion, i: int, middle: Point, radius: float) -> float:
    """Returns how far module i moves the points of a ball above it at most."""
    moved = 0.0
    if motion.turns[i] > 0 or motion.moves[i] > 0:
        moved = motion.moves[i] + motion.turns[i] * lever(motion, i, middle, radius)
    return float(moved)


@kernel(types.void(CHAINS, SWITCHING, int64, BOX_MOTION), **UNCOUNTED)
def write_motion(chains: Chains, switching: Switching, box: int, motion: BoxMotion) -> None:
    """Writes the arm in the middle of a box, and the bounds on its motion."""
    owners, rates, half_widths = switching
    r, b, moves, turns, swells, _ = motion
    moves[:], turns[:], swells[:] = 0.0, 0.0, 0.0
    for a in range(len(owners)):
        moves[owners[a]] += half_widths[box, a] * rates[a, 0]
        turns[owners[a]] += half_widths[box, a] * rates[a, 1]
        swells[owners[a]] += half_widths[box, a] * rates[a, 2]
    for c in range(3):
        b[0, c] = chains.translations[box, 0, c]
        for d in range(3):
            r[0, c, d] = chains.rotations[box, 0, c, d]
    for i in range(len(moves)):
        compose(r[i], b[i], chains.rotations[box, i + 1], chains.translations[box, i + 1], r[i + 1], b[i + 1])


@kernel([NEAR(CHAINS, int64, BOX_MOTION, SURROUNDINGS, int64, POINT)], **UNCOUNTED)
def near_obstacle(
    chains: Chains, box: int, motion: BoxMotion, surroundings: Surroundings, j: int, middle: Point
) -> tuple[int, float, bool]:
    """Returns the first obstacle that module j may touch, -1 for none; the bound on its motion; whether it touches.

    `middle` is the centre of the module's ball in the world.
    """
    r, b, margin = motion.rotations[j], motion.positions[j], surroundings.margin
    body, ball = chains.bodies[box, j, : chains.lines[j]], chains.balls[box, j]
    swept = motion.swells[j]
    for i in range(j):
        swept += carried(motion, i, middle, ball[3])
    obstacle = first_obstacle(r, b, body, ball, surroundings, margin + swept)
    return obstacle, swept, obstacle >= 0 and first_obstacle(r, b, body, ball, surroundings, margin) >= 0


@kernel([NEAR(CHAINS, int64, BOX_MOTION, float64, int64, POINT)], **UNCOUNTED)
def near_module(
    chains: Chains, box: int, motion: BoxMotion, apart: float, j: int, middle: Point
) -> tuple[int, float, bool]:
    """Returns the first module below that module j may touch, -1 for none; the bound on their motion; whether they do.

    The bound is that of one module as seen from the other. For the arguments see near_obstacle.
    """
    r, b, lines = motion.rotations, motion.positions, chains.lines
    ball, swept = chains.balls[box, j], motion.swells[j]
    for i in range(j - 1, -1, -1):
        swept += carried(motion, i, middle, ball[3])
        near = apart + swept + motion.swells[i]
        x, y, z = placed(r[i], b[i], chains.balls[box, i, :3])
        if i < j - 1 and away(middle, x, y, z) <= ball[3] + chains.balls[box, i, 3] + near:
            body, below = chains.bodies[box, j, : lines[j]], chains.bodies[box, i, : lines[i]]
            gap = body_distance(r[j], b[j], body, r[i], b[i], below, motion.segments)
            if gap <= near:
                return i, swept + motion.swells[i], gap <= apart
    return -1, swept, False


@kernel([WORST(CHAINS, int64, BOX_MOTION, SURROUNDINGS, boolean[:, ::1], I2)], **UNCOUNTED)
def check_box(
    chains: Chains, box: int, motion: BoxMotion, surroundings: Surroundings, suspects: Flags, reports: Index
) -> tuple[int, int, bool]:
    """Checks the suspects of one box, from base to tip, up to one that collides in the middle of the box.

    Returns the module that collides, otherwise the one with the greatest bound on its motion, -1 if all are clear; the
    lowest module in this bound; and whether the module collides. For the arguments see swept_check.
    """
    greatest, worst, lowest = -1.0, -1, 0
    for j in range(len(motion.moves)):
        if not suspects[box, j]:
            continue
        middle = placed(motion.rotations[j], motion.positions[j], chains.balls[box, j, :3])
        other, low = -1, 0
        obstacle, swept, collides = near_obstacle(chains, box, motion, surroundings, j, middle)
        if surroundings.apart >= 0 and obstacle < 0:
            other, swept, collides = near_module(chains, box, motion, surroundings.apart, j, middle)
            low = max(other, 0)
        suspects[box, j] = obstacle >= 0 or other >= 0
        if suspects[box, j] and (collides or swept > greatest):
            greatest, worst, lowest = swept, j, low
            reports[box, 0], reports[box, 1], reports[box, 2] = j, obstacle, other
        if collides:
            return worst, lowest, True
    return worst, lowest, False


@kernel(int64(CHAINS, SWITCHING, int64, BOX_MOTION, int64, int64), **UNCOUNTED)
def widest_actuator(chains: Chains, switching: Switching, box: int, motion: BoxMotion, worst: int, lowest: int) -> int:
    """Returns the actuator of modules lowest to worst that adds most to the bound on the motion of module worst."""
    owners, rates, half_widths = switching
    ball, most, widest = chains.balls[box, worst], -1.0, CLEAR
    middle = placed(motion.rotations[worst], motion.positions[worst], ball[:3])
    for a in range(len(owners)):
        i = owners[a]
        if i < lowest or i > worst:
            continue
        share = rates[a, 2] if i == worst or (i == lowest and lowest > 0) else 0.0
        if i < worst:
            share += rates[a, 0] + rates[a, 1] * lever(motion, i, middle, ball[3])
        if half_widths[box, a] * share > most:
            most, widest = half_widths[box, a] * share, a
    return widest


@kernel(I1(CHAINS, SWITCHING, SURROUNDINGS, boolean[:, ::1], I2))
def swept_check(
    chains: Chains, switching: Switching, surroundings: Surroundings, suspects: Flags, reports: Index
) -> Index:
    """Returns for each box of displacements CLEAR, COLLIDING (in its middle), or the actuator along which to cut it.

    Args:
        suspects: modules to check, shape (n, B); the kernel clears those that it proves clear.
        reports: written: module, obstacle and other module of a possible collision, shape (n, 3).
    """
    boxes, modules = suspects.shape
    result = np.full(boxes, CLEAR)
    rotations, positions = np.empty((modules + 1, 3, 3)), np.empty((modules + 1, 3))
    bounds = np.empty((3, modules))
    motion = BoxMotion(rotations, positions, bounds[0], bounds[1], bounds[2], np.empty((2, 2, 3)))
    for box in range(boxes):
        write_motion(chains, switching, box, motion)
        worst, lowest, collides = check_box(chains, box, motion, surroundings, suspects, reports)
        if collides:
            result[box] = COLLIDING
        elif worst >= 0:
            result[box] = widest_actuator(chains, switching, box, motion, worst, lowest)
    return result
