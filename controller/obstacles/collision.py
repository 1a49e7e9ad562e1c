"""The first collision of a configuration, from base to tip, with an obstacle or between two modules."""

from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, types

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.frame_kernels import compose
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, F4, F5, I1, I2, UNCOUNTED, named
from hyperbit.controller.obstacles.distance import SURROUNDINGS, Array, Index, Surroundings, first_obstacle, placed


class ArmBodies(NamedTuple):
    """Frames and bodies of an arm, for kernels."""

    rotations: Array  # configuration sets, shape (B, Kmax, 3, 3)
    translations: Array  # configuration sets, shape (B, Kmax, 3)
    bodies: Array  # see BodyClearance
    balls: Array  # see BodyClearance
    lines: Index  # see BodyClearance


class WorldBodies(NamedTuple):
    """The bodies of one configuration in the world, written from base to tip. Only used with self-collision."""

    ends: Array  # line segments, shape (B, Lmax, 2, 3)
    balls: Array  # centres and radii of balls around them, shape (B, 4)


ARM_BODIES = named(ArmBodies, F4, F3, F5, F3, I1)
WORLD_BODIES = named(WorldBodies, F4, F2)
TOUCH: Any = types.UniTuple(int64, 2)  # type: ignore[no-untyped-call]


@kernel("f8(f8[:,::1], f8[:,::1])", **UNCOUNTED, error_model="numpy")
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


@kernel(int64(WORLD_BODIES, I1, int64, float64), **UNCOUNTED)
def first_module(world: WorldBodies, lines: Index, i: int, apart: float) -> int:
    """Returns the first module below module i that is at most `apart` away, without its neighbour; -1 for none.

    `world` has the bodies of modules up to i, `lines` (B,) the number of line segments of each module.
    """
    ends, balls = world.ends, world.balls
    for j in range(i - 1):
        square = 0.0
        for a in range(3):
            square += (balls[i, a] - balls[j, a]) ** 2
        if square > (balls[i, 3] + balls[j, 3] + apart) ** 2:
            continue
        for m in range(lines[i]):
            for n in range(lines[j]):
                if lines_distance(ends[i, m], ends[j, n]) <= apart:
                    return j
    return -1


@kernel([TOUCH(ARM_BODIES, SURROUNDINGS, int64, int64, F2, F1, WORLD_BODIES)], **UNCOUNTED, error_model="numpy")
def first_touch(
    arm: ArmBodies, surroundings: Surroundings, i: int, state: int, r: Array, b: Array, world: WorldBodies
) -> tuple[int, int]:
    """Returns the first obstacle that a module touches, otherwise the first module below; -1 for none.

    With self-collision, call in order, base to tip. The module is in `state`, on a frame with rotation `r` (3, 3) and
    position `b` (3,) in the world. The kernel writes its body to `world`, and reads those of the modules below.
    """
    body, ball = arm.bodies[i, state, : arm.lines[i]], arm.balls[i, state]
    obstacle = first_obstacle(r, b, body, ball, surroundings, surroundings.margin)
    if obstacle >= 0 or surroundings.apart < 0:
        return obstacle, -1
    ends, balls = world.ends, world.balls
    for n in range(arm.lines[i]):
        for end in range(2):
            ends[i, n, end, 0], ends[i, n, end, 1], ends[i, n, end, 2] = placed(r, b, body[n, end])
    balls[i, 0], balls[i, 1], balls[i, 2] = placed(r, b, ball[:3])
    balls[i, 3] = ball[3]
    return -1, first_module(world, arm.lines, i, surroundings.apart)


@kernel(I2(F2, F1, ARM_BODIES, SURROUNDINGS, I2))
def first_collisions(
    base_r: Array, base_b: Array, arm: ArmBodies, surroundings: Surroundings, configurations: Index
) -> Index:
    """Returns the first collision of each configuration (n, B), shape (n, 3).

    A row has the module, the obstacle that it touches, and the other module that it touches; -1 for none. Frame F_0 has
    rotation `base_r` (3, 3) and position `base_b` (3,) in the world.
    """
    n, modules = configurations.shape
    result = np.full((n, 3), -1)
    r, b = np.empty((3, 3)), np.empty(3)
    world = WorldBodies(np.empty((modules, arm.bodies.shape[2], 2, 3)), np.empty((modules, 4)))
    for c in range(n):
        for a in range(3):
            b[a] = base_b[a]
            for d in range(3):
                r[a, d] = base_r[a, d]
        for i in range(modules):
            state = configurations[c, i]
            obstacle, other = first_touch(arm, surroundings, i, state, r, b, world)
            if obstacle >= 0 or other >= 0:
                result[c, 0], result[c, 1], result[c, 2] = i, obstacle, other
                break
            compose(r, b, arm.rotations[i, state], arm.translations[i, state], r, b)
    return result
