"""Changes of one configuration: memory for them, where they move the tip, and what they find."""

from typing import NamedTuple

import numpy as np
from numba import boolean, float32, float64, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, I2, S1, UNCOUNTED, named
from hyperbit.controller.obstacles.scene import Scene, for_scenes
from hyperbit.controller.search.lists.segment import compose, invert
from hyperbit.controller.search.neighbours.chain import CHAIN, PLACES, Chain, Places, fits, state_of

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Index32 = NDArray[np.int32]


class Changed(NamedTuple):
    """Memory for the changes of one configuration. `m` rows have room."""

    frames: Array  # frames F_0 to F_B of the configuration, their inverses, three of scratch, shape (2 * B + 5, ...)
    upper: Singles  # points of the tip, shape (3, m)
    upper_costs: Array  # shape (m,)
    upper_keys: Integers  # differences of keys, shape (words, m)
    rests: Singles  # those points that changes of lower modules may move, shape (3, m)
    rest_costs: Array  # shape (m,)
    rest_keys: Integers  # shape (words, m)
    ends: Integers  # number of points without changes of module i and those below, shape (B,)
    lower: Array  # points of the goal, shape (m, 3)
    lower_costs: Array  # shape (m,)
    lower_keys: Integers  # shape (words, m)
    links: Index32  # next point in the same hash slot, -1 for none, shape (m,)
    heads: Index32  # first point of each hash slot; the number of slots is a power of two
    key: Integers  # scratch, shape (1, words)
    module_states: Integers  # scratch, shape (B,)


class Found(NamedTuple):
    """Configurations found. A configuration may be listed more than once from the same source."""

    sources: Integers  # number of the source, shape (n,)
    keys: Integers  # shape (n, words)
    costs: Array  # from the source, shape (n,)
    written: Integers  # number of configurations, shape (1,)


SINGLES = float32[:, ::1]
CHANGED = named(Changed, F2, SINGLES, F1, I2, SINGLES, F1, I2, I1, F2, F1, I2, S1, S1, I2, I1)
FOUND = named(Found, I1, I2, F1, I1)


def room_for_changes(chain: Chain, rows: int) -> Changed:
    """Returns memory for `rows` changes."""
    modules, width, words = len(chain.states), chain.motions.shape[1], int(chain.words[-1]) + 1
    slots = 1 << max(rows - 1, 1).bit_length()
    frames = np.zeros((2 * modules + 5, width))
    frames[0, 2 if width == 4 else 3 :: 2 if width == 4 else 4] = 1.0
    points, costs, keys = np.empty((6, rows), np.float32), np.empty((3, rows)), np.empty((3, words, rows), np.int64)
    return Changed(
        *(frames, points[:3], costs[0], keys[0], points[3:], costs[1], keys[1], np.empty(modules, np.int64)),
        *(np.empty((rows, 3)), costs[2], keys[2], np.empty(rows, np.int32), np.empty(slots, np.int32)),
        *(np.zeros((1, words), np.int64), np.zeros(modules, np.int64)),
    )


@kernel("b1(f4[:,::1], u8, u8, f4, f4, f4, f4, b1)", **UNCOUNTED, fastmath=True)
def any_near(points: Singles, begin: int, end: int, x: float, y: float, z: float, square: float, planar: bool) -> bool:
    """Returns whether one of some points (3, m) is within a squared distance of (x, y, z)."""
    total, none = np.float32(0), np.float32(0)
    if planar:
        for a in range(begin, end):
            u, v = points[0, a] - x, points[1, a] - y
            total += max(none, square - (u * u + v * v))
    else:
        for a in range(begin, end):
            u, v, w = points[0, a] - x, points[1, a] - y, points[2, a] - z
            total += max(none, square - (u * u + v * v + w * w))
    return bool(total > none)


@kernel("f8(f4[:,::1], i8, f8, f8, f8)", **UNCOUNTED, inline="always")
def square_to(points: Singles, n: int, x: float, y: float, z: float) -> float:
    """Returns the squared distance of (x, y, z) from points (3, m) at n."""
    return float((points[0, n] - x) ** 2 + (points[1, n] - y) ** 2 + (points[2, n] - z) ** 2)


@kernel("void(f8[:,::1], i8, f4[:,::1], u8, f4[:,::1], u8)", **UNCOUNTED)
def move_all(frames: Array, n: int, points: Singles, count: int, out: Singles, at: int) -> None:
    """Writes the first points (3, m), moved by frames[n], to out[:, at:]."""
    if frames.shape[1] == 4:
        x, y = np.float32(frames[n, 0]), np.float32(frames[n, 1])
        c, s = np.float32(frames[n, 2]), np.float32(frames[n, 3])
        for m in range(count):
            out[0, at + m] = x + c * points[0, m] - s * points[1, m]
            out[1, at + m] = y + s * points[0, m] + c * points[1, m]
            out[2, at + m] = np.float32(0)
    else:
        for a in range(3):
            t, u = np.float32(frames[n, a]), np.float32(frames[n, 3 + 3 * a])
            v, w = np.float32(frames[n, 4 + 3 * a]), np.float32(frames[n, 5 + 3 * a])
            for m in range(count):
                out[a, at + m] = t + u * points[0, m] + v * points[1, m] + w * points[2, m]


@kernel(types.void(CHAIN, CHANGED, I2, int64), **UNCOUNTED)
def prepare(chain: Chain, changed: Changed, keys: Integers, n: int) -> None:
    """Computes the frames of keys[n] and their inverses."""
    frames, movements, kinds, modules = changed.frames, chain.motions, chain.costs.shape[1], len(chain.states)
    for i in range(modules):
        compose(frames, i, movements, i * kinds + state_of(chain, keys, n, i), frames, i + 1)
    for i in range(modules + 1):
        invert(frames, i, frames, modules + 1 + i)


@kernel(types.void(CHAIN, CHANGED, int64, int64), **UNCOUNTED)
def put_motion(chain: Chain, changed: Changed, i: int, j: int) -> None:
    """Writes the motion of all above module i, when it takes state j, to the last frame but two."""
    frames, modules = changed.frames, len(chain.states)
    compose(frames, i, chain.motions, i * chain.costs.shape[1] + j, frames, 2 * modules + 3)
    compose(frames, 2 * modules + 3, frames, modules + 2 + i, frames, 2 * modules + 2)


@kernel(
    for_scenes(lambda scene: boolean(CHAIN, PLACES, int64, scene, CHANGED, I2, int64, int64, int64, float64, FOUND)),
    **UNCOUNTED,
)
def emit(
    chain: Chain,
    places: Places,
    k: int,
    scene: Scene | None,
    changed: Changed,
    keys: Integers,
    n: int,
    upper: int,
    lower: int,
    cost: float,
    found: Found,
) -> bool:
    """Lists keys[n] with a change of the upper modules and one of the lower, if it serves; False if there is no room.

    -1 means no change.
    """
    key, frames = changed.key, changed.frames
    for a in range(keys.shape[1]):
        key[0, a] = keys[n, a]
        if upper >= 0:
            key[0, a] ^= changed.upper_keys[a, upper]
        if lower >= 0:
            key[0, a] ^= changed.lower_keys[a, lower]
    if not fits(chain, places, k, scene, frames, key, 0, changed.module_states):
        return True
    count = found.written[0]
    if count == len(found.sources):
        return False
    found.sources[count], found.costs[count] = n, cost
    for a in range(keys.shape[1]):
        found.keys[count, a] = key[0, a]
    found.written[0] = count + 1
    return True
