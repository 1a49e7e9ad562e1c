"""Neighbours of configurations: all configurations that serve a point and cost little from a given one.

A change sets modules to other states. The modules' changes are rigid motions of all that is above them, so a change of
several modules moves the tip by a product of them, the lowest module's last (meet in the middle): the upper modules'
changes move the tip to points, the inverse changes of the lower modules move the goal to points, and the two must meet.
"""

from typing import NamedTuple

import numpy as np
from numba import boolean, float32, float64, int64, njit, types
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, I1, I2, S1, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.scene import Scene, collides, for_scenes
from hyperbit.controller.search.method import costs_between_states
from hyperbit.controller.search.segment import compose, invert, motions

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Index32 = NDArray[np.int32]
Flags = NDArray[np.bool_]
Point = tuple[float, float, float]

WORD = 63  # bits of a word of a key
ROUNDING = 1e-9  # relative rounding error of sums of weights
BLUR = 4e-6  # rounding error of points in single precision, relative to the arm's length
FEW, FEWER = 4096, 256  # points that are compared one by one; if several lower modules change. More are put into cells
CELL = 2.000001  # width of a cell in search radii: rounding must not put near points more than one cell apart


class Chain(NamedTuple):
    """The arm for kernels. A key has the states of all modules, module by module, in words of up to WORD bits."""

    motions: Array  # see segment, shape (B * Kmax, 4) or (B * Kmax, 12)
    states: Integers  # K_i, shape (B,)
    costs: Array  # cost of each module's states from each other, shape (B, Kmax, Kmax)
    words: Integers  # word of each module, shape (B,)
    shifts: Integers  # its lowest bit there, shape (B,)
    masks: Integers  # greatest state, rounded up to ones, shape (B,)
    least: float  # least cost of a switch
    whole: bool  # whether all costs are multiples of it
    blur: float  # rounding error of points in single precision


class Places(NamedTuple):
    """The points of a trajectory, in frame F_0."""

    positions: Array  # shape (n, 3)
    rotations: Array  # cos and sin, or row by row, shape (n, 2) or (n, 9)
    radii: Array  # greatest distances, shape (n,)
    chords: Array  # greatest squared chords; infinite without orientation, shape (n,)
    fixed: Flags  # whether a point is given as a configuration, shape (n,)
    given: Integers  # its key, shape (n, words)


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


CHAIN = named(Chain, F2, I1, F3, I1, I1, I1, float64, boolean, float64)
PLACES = named(Places, F2, F2, F1, F1, boolean[::1], I2)
SINGLES = float32[:, ::1]
CHANGED = named(Changed, F2, SINGLES, F1, I2, SINGLES, F1, I2, I1, F2, F1, I2, S1, S1, I2, I1)
FOUND = named(Found, I1, I2, F1, I1)
MOVED = "UniTuple(f8, 3)(f8[:,::1], i8, f8, f8, f8)"


def chain_of(manipulator: Manipulator, weights: Array, least: float, whole: bool) -> Chain:
    """Returns the arm for kernels, by weights of switches (B, Amax); `least` and `whole`: see Chain."""
    bits = [max(int(k) - 1, 1).bit_length() for k in manipulator.states]
    words, shifts, used, word = list[int](), list[int](), 0, 0
    for width in bits:
        word, used = (word + 1, 0) if used + width > WORD else (word, used)
        words.append(word)
        shifts.append(used)
        used += width
    masks = np.array([(1 << width) - 1 for width in bits], dtype=np.int64)
    places = np.array(words, dtype=np.int64), np.array(shifts, dtype=np.int64)
    costs = costs_between_states(manipulator, weights)
    return Chain(
        motions(manipulator), manipulator.states, costs, *places, masks, least, whole, BLUR * manipulator.length
    )


def keys_of(chain: Chain, configurations: ArrayLike) -> Integers:
    """Returns configurations (n, B) as keys (n, words)."""
    states = np.atleast_2d(np.asarray(configurations, dtype=np.int64))
    keys = np.zeros((len(states), int(chain.words[-1]) + 1), np.int64)
    for i, (word, shift) in enumerate(zip(chain.words, chain.shifts, strict=True)):
        keys[:, word] |= states[:, i] << shift
    return keys


def states_of(chain: Chain, keys: Integers) -> Integers:
    """Returns keys (n, words) as configurations (n, B)."""
    states: Integers = (keys[:, chain.words] >> chain.shifts) & chain.masks
    return states


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


@njit(int64(CHAIN, I2, int64, int64), **UNCOUNTED, inline="always")
def state_of(chain: Chain, keys: Integers, n: int, i: int) -> int:
    """Returns the state of module i in keys[n]."""
    return int((keys[n, chain.words[i]] >> chain.shifts[i]) & chain.masks[i])


@njit(MOVED, **UNCOUNTED, inline="always")
def moved(frames: Array, n: int, x: float, y: float, z: float) -> Point:
    """Returns a point moved by frames[n]."""
    if frames.shape[1] == 4:
        c, s = frames[n, 2], frames[n, 3]
        return frames[n, 0] + c * x - s * y, frames[n, 1] + s * x + c * y, 0.0
    return (
        frames[n, 0] + frames[n, 3] * x + frames[n, 4] * y + frames[n, 5] * z,
        frames[n, 1] + frames[n, 6] * x + frames[n, 7] * y + frames[n, 8] * z,
        frames[n, 2] + frames[n, 9] * x + frames[n, 10] * y + frames[n, 11] * z,
    )


@njit(MOVED, **UNCOUNTED, inline="always")
def moved_back(frames: Array, n: int, x: float, y: float, z: float) -> Point:
    """Returns a point moved by the inverse of frames[n]."""
    if frames.shape[1] == 4:
        x, y, c, s = x - frames[n, 0], y - frames[n, 1], frames[n, 2], frames[n, 3]
        return c * x + s * y, c * y - s * x, 0.0
    x, y, z = x - frames[n, 0], y - frames[n, 1], z - frames[n, 2]
    return (
        frames[n, 3] * x + frames[n, 6] * y + frames[n, 9] * z,
        frames[n, 4] * x + frames[n, 7] * y + frames[n, 10] * z,
        frames[n, 5] * x + frames[n, 8] * y + frames[n, 11] * z,
    )


@njit(int64(CHAIN, I2, int64, F2), **UNCOUNTED)
def write_tip(chain: Chain, keys: Integers, n: int, frames: Array) -> int:
    """Writes the tip of keys[n] in F_0 to one of the last two frames; returns which."""
    motions, kinds, now = chain.motions, chain.costs.shape[1], len(frames) - 1
    for a in range(frames.shape[1]):
        frames[now, a] = motions[state_of(chain, keys, n, 0), a]
    for i in range(1, len(chain.states)):
        following = len(frames) - 1 if now == len(frames) - 2 else len(frames) - 2
        compose(frames, now, motions, i * kinds + state_of(chain, keys, n, i), frames, following)
        now = following
    return now


@njit(boolean(PLACES, int64, F2, int64, I2, int64), **UNCOUNTED)
def serves(places: Places, k: int, tips: Array, tip: int, keys: Integers, n: int) -> bool:
    """Returns whether keys[n], whose tip is tips[tip], serves point k, with a slightly larger tolerance."""
    if places.fixed[k]:
        same = True
        for a in range(keys.shape[1]):
            same &= keys[n, a] == places.given[k, a]
        return same
    size, square, chord = 2 if tips.shape[1] == 4 else 3, 0.0, 0.0
    for a in range(size):
        square += (tips[tip, a] - places.positions[k, a]) ** 2
    if square > places.radii[k] ** 2:
        return False
    if places.chords[k] < np.inf:
        for a in range(places.rotations.shape[1]):
            chord += (tips[tip, size + a] - places.rotations[k, a]) ** 2
        return bool(chord * (1.0 if size == 2 else 0.5) <= places.chords[k])
    return True


@njit(
    for_scenes(lambda scene: boolean(CHAIN, PLACES, int64, scene, F2, I2, int64, I1)),
    **UNCOUNTED,
)
def fits(
    chain: Chain, places: Places, k: int, scene: Scene | None, frames: Array, keys: Integers, n: int, states: Integers
) -> bool:
    """Returns whether keys[n] serves point k and is clear; the last two frames and states (B,) are scratch."""
    if not serves(places, k, frames, write_tip(chain, keys, n, frames), keys, n):
        return False
    if scene is not None:
        for i in range(len(states)):
            states[i] = state_of(chain, keys, n, i)
        return not collides(scene, states)
    return True


@njit("b1(f4[:,::1], u8, u8, f4, f4, f4, f4, b1)", **UNCOUNTED, fastmath=True)
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


@njit("f8(f4[:,::1], i8, f8, f8, f8)", **UNCOUNTED, inline="always")
def square_to(points: Singles, n: int, x: float, y: float, z: float) -> float:
    """Returns the squared distance of (x, y, z) from points (3, m) at n."""
    return float((points[0, n] - x) ** 2 + (points[1, n] - y) ** 2 + (points[2, n] - z) ** 2)


@njit("i8(i8, i8, i8)", **UNCOUNTED, inline="always")
def hash_of(i: int, j: int, k: int) -> int:
    """Returns a hash of a cell's coordinates, at least 0."""
    return (i * 73856093 ^ j * 19349663 ^ k * 83492791) & 0x7FFFFFFF


@njit("void(f8[:,::1], i8, f4[:,::1], u8, f4[:,::1], u8)", **UNCOUNTED)
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


@njit(types.void(CHAIN, CHANGED, I2, int64), **UNCOUNTED)
def prepare(chain: Chain, changed: Changed, keys: Integers, n: int) -> None:
    """Computes the frames of keys[n] and their inverses."""
    frames, movements, kinds, modules = changed.frames, chain.motions, chain.costs.shape[1], len(chain.states)
    for i in range(modules):
        compose(frames, i, movements, i * kinds + state_of(chain, keys, n, i), frames, i + 1)
    for i in range(modules + 1):
        invert(frames, i, frames, modules + 1 + i)


@njit(types.void(CHAIN, CHANGED, int64, int64), **UNCOUNTED)
def put_motion(chain: Chain, changed: Changed, i: int, j: int) -> None:
    """Writes the motion of all above module i, when it takes state j, to the last frame but two."""
    frames, modules = changed.frames, len(chain.states)
    compose(frames, i, chain.motions, i * chain.costs.shape[1] + j, frames, 2 * modules + 3)
    compose(frames, 2 * modules + 3, frames, modules + 2 + i, frames, 2 * modules + 2)


@njit(
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


@njit(
    for_scenes(lambda scene: int64(CHAIN, PLACES, int64, scene, CHANGED, I2, int64, float64, FOUND)),
    **UNCOUNTED,
    error_model="numpy",
)
def list_upper(
    chain: Chain,
    places: Places,
    k: int,
    scene: Scene | None,
    changed: Changed,
    keys: Integers,
    n: int,
    budget: float,
    found: Found,
) -> int:
    """Lists where changes of keys[n] move the tip, highest modules first; returns their number.

    A change may cost up to half the budget above its lowest module: changes of the modules below match the others.
    Changes that serve by themselves are found. Returns -1 if the memory is full, -2 if `found` is.
    """
    points, costs, rows, frames = changed.upper, changed.upper_costs, changed.upper_keys, changed.frames
    rests, rest_costs, rest_rows = changed.rests, changed.rest_costs, changed.rest_keys
    (modules, kinds), words, planar = chain.costs.shape[:2], keys.shape[1], frames.shape[1] == 4
    goal_x, goal_y, goal_z = places.positions[k, 0], places.positions[k, 1], places.positions[k, 2]
    square, room, limit, dearest = (places.radii[k] + chain.blur) ** 2, len(costs), budget / 2, 0.0
    if chain.whole:
        limit = budget - (np.floor(budget / (2 * chain.least)) + 1) * chain.least
    count, many = 0, 0
    for i in range(modules - 1, -1, -1):
        changed.ends[i] = count
        before, s = many, state_of(chain, keys, n, i)
        lowest = chain.least if i > 0 else np.inf
        tip_x, tip_y, tip_z = moved_back(
            frames, i + 1, frames[modules, 0], frames[modules, 1], 0.0 if planar else frames[modules, 2]
        )
        for j in range(chain.states[i]):
            own = chain.costs[i, s, j]
            if j == s or own > budget:
                continue
            if count + before + 1 > room or many + before + 1 > room:
                return -1
            x, y, z = moved(chain.motions, i * kinds + j, tip_x, tip_y, tip_z)
            x, y, z = moved(frames, i, x, y, z)
            points[0, count], points[1, count], points[2, count], costs[count] = x, y, z, own
            near, end, some = square_to(points, count, goal_x, goal_y, goal_z) <= square, count + 1, False
            if before > 0 and own + chain.least <= budget:
                put_motion(chain, changed, i, j)
                move_all(frames, len(frames) - 3, rests, before, points, end)
                near |= any_near(points, end, end + before, goal_x, goal_y, goal_z, square, planar)
                some = own + chain.least + lowest <= budget
                if near or some:
                    end += before
            if not near and own + lowest > budget:
                continue
            delta, word = (s ^ j) << chain.shifts[i], chain.words[i]
            for a in range(words):
                rows[a, count] = 0
                for m in range(end - count - 1):
                    rows[a, count + 1 + m] = rest_rows[a, m]
            for m in range(end - count - 1):
                costs[count + 1 + m] = own + rest_costs[m]
            for m in range(count, end):
                rows[word, m] ^= delta
            if near:
                for m in range(count, end):
                    if costs[m] > budget or square_to(points, m, goal_x, goal_y, goal_z) > square:
                        continue
                    if not emit(chain, places, k, scene, changed, keys, n, m, -1, costs[m], found):
                        return -2
            if own + lowest > budget:
                continue
            last = end if some else count + 1
            whole = own + dearest + lowest <= budget and own + chain.least > limit
            for m in range(count, count + 1 if whole else last):
                cost = costs[m]
                if cost + lowest > budget:
                    continue
                points[0, count], points[1, count], points[2, count] = points[0, m], points[1, m], points[2, m]
                costs[count] = cost
                for a in range(words):
                    rows[a, count] = rows[a, m]
                if cost <= limit:
                    rests[0, many], rests[1, many], rests[2, many] = points[0, m], points[1, m], points[2, m]
                    rest_costs[many], dearest = cost, max(dearest, cost)
                    for a in range(words):
                        rest_rows[a, many] = rows[a, m]
                    many += 1
                count += 1
            if whole:
                count = last
    return count


@njit(int64(CHANGED, int64, float64), **UNCOUNTED, error_model="numpy")
def put_into_cells(changed: Changed, count: int, radius: float) -> int:
    """Puts the first points of the tip into hashed cells; returns the number of hash slots."""
    points, links, heads, per, slots = changed.upper, changed.links, changed.heads, 1.0 / (CELL * radius), 64
    while slots < 2 * count and slots < len(heads):
        slots *= 2
    heads[:slots] = -1
    for m in range(count):
        x, y, z = np.floor(points[0, m] * per), np.floor(points[1, m] * per), np.floor(points[2, m] * per)
        slot = hash_of(int(x), int(y), int(z)) & (slots - 1)
        links[m], heads[slot] = heads[slot], m
    return slots


@njit(
    for_scenes(
        lambda scene: boolean(CHAIN, PLACES, int64, scene, CHANGED, I2, int64, float64, FOUND, int64, int64, int64)
    ),
    **UNCOUNTED,
    error_model="numpy",
)
def match(
    chain: Chain,
    places: Places,
    k: int,
    scene: Scene | None,
    changed: Changed,
    keys: Integers,
    n: int,
    budget: float,
    found: Found,
    m: int,
    end: int,
    slots: int,
) -> bool:
    """Finds the first `end` points of the tip that meet point `m` of the goal; False if there is no room for them.

    `slots` is the number of hash slots, or 0: all points are compared.
    """
    points, costs, own, links = changed.upper, changed.upper_costs, changed.lower_costs[m], changed.links
    x, y, z, planar = changed.lower[m, 0], changed.lower[m, 1], changed.lower[m, 2], changed.frames.shape[1] == 4
    radius, corners = places.radii[k] + chain.blur, 1 if slots == 0 else 4 if planar else 8
    square, per = radius * radius, 1.0 / (CELL * radius)
    i, j, h = int(np.floor(x * per - 0.5)), int(np.floor(y * per - 0.5)), int(np.floor(z * per - 0.5))
    for corner in range(corners):
        at = end - 1
        if slots > 0:
            depth = 0 if planar else h + (corner >> 2)
            at = changed.heads[hash_of(i + (corner & 1), j + ((corner >> 1) & 1), depth) & (slots - 1)]
        while at >= 0:
            fitting = at < end and costs[at] + own <= budget and square_to(points, at, x, y, z) <= square
            if fitting and not emit(chain, places, k, scene, changed, keys, n, at, m, costs[at] + own, found):
                return False
            at = links[at] if slots > 0 else at - 1
    return True


@njit(
    for_scenes(lambda scene: int64(CHAIN, PLACES, int64, scene, CHANGED, I2, int64, float64, FOUND, int64)),
    **UNCOUNTED,
    error_model="numpy",
)
def match_lower(
    chain: Chain,
    places: Places,
    k: int,
    scene: Scene | None,
    changed: Changed,
    keys: Integers,
    n: int,
    budget: float,
    found: Found,
    count: int,
) -> int:
    """Matches changes of the lower modules with `count` points of the tip; returns as `list_upper`."""
    goals, costs, rows, frames, points = (
        changed.lower,
        changed.lower_costs,
        changed.lower_keys,
        changed.frames,
        changed.upper,
    )
    (modules, kinds), words, planar, half = chain.costs.shape[:2], keys.shape[1], frames.shape[1] == 4, budget / 2
    radius, many = places.radii[k] + chain.blur, 1
    square, slots = radius * radius, 0
    if count > (FEW if half < 2 * chain.least else FEWER):
        slots = put_into_cells(changed, count, radius)
    for a in range(3):
        goals[0, a] = places.positions[k, a]
    for a in range(words):
        rows[a, 0] = 0
    costs[0] = 0.0
    for i in range(modules - 1):
        before, s, end = many, state_of(chain, keys, n, i), changed.ends[i]
        highest = chain.least if i + 1 < modules - 1 else np.inf
        goal_x, goal_y, goal_z = moved_back(frames, i, goals[0, 0], goals[0, 1], goals[0, 2])
        for j in range(chain.states[i]):
            own = chain.costs[i, s, j]
            if j == s or own > half:
                continue
            if before > 1:
                put_motion(chain, changed, i, j)
            for m in range(before):
                cost = costs[m] + own
                if cost > half:
                    continue
                if many == len(costs):
                    return -1
                if m == 0:
                    x, y, z = moved_back(chain.motions, i * kinds + j, goal_x, goal_y, goal_z)
                    x, y, z = moved(frames, i + 1, x, y, z)
                else:
                    x, y, z = moved_back(frames, len(frames) - 3, goals[m, 0], goals[m, 1], goals[m, 2])
                if slots == 0 and not any_near(points, 0, end, x, y, z, square, planar) and cost + highest > half:
                    continue
                goals[many, 0], goals[many, 1], goals[many, 2], costs[many] = x, y, z, cost
                for a in range(words):
                    rows[a, many] = rows[a, m]
                rows[chain.words[i], many] ^= (s ^ j) << chain.shifts[i]
                if not match(chain, places, k, scene, changed, keys, n, budget, found, many, end, slots):
                    return -2
                if cost + highest <= half:
                    many += 1
    return many


@njit(
    for_scenes(lambda scene: int64(CHAIN, PLACES, int64, scene, I2, F1, CHANGED, FOUND)),
    **UNCOUNTED,
    error_model="numpy",
)
def list_near(
    chain: Chain,
    places: Places,
    k: int,
    scene: Scene | None,
    keys: Integers,
    budgets: Array,
    changed: Changed,
    found: Found,
) -> int:
    """Finds all clear configurations that serve point k and cost at most a budget (n,) from a key (n, words).

    Returns the number of keys that are done; if not all are, minus that and 1 if `changed` is too small for the next.
    """
    for n in range(len(keys)):
        begun = found.written[0]
        budget = budgets[n] + chain.least * 1e-6 if chain.whole else budgets[n] * (1 + ROUNDING)
        if places.fixed[k]:
            cost = 0.0
            for i in range(len(chain.states)):
                cost += chain.costs[i, state_of(chain, keys, n, i), state_of(chain, places.given, k, i)]
            if cost <= budget and not emit(chain, places, k, scene, changed, places.given, k, -1, -1, cost, found):
                return n
            if found.written[0] > begun:
                found.sources[begun] = n
            continue
        done = 0
        if not emit(chain, places, k, scene, changed, keys, n, -1, -1, 0.0, found):
            done = -2
        elif budget >= chain.least:
            prepare(chain, changed, keys, n)
            done = list_upper(chain, places, k, scene, changed, keys, n, budget, found)
            if done > 0:
                done = match_lower(chain, places, k, scene, changed, keys, n, budget, found, done)
        if done < 0:
            found.written[0] = begun
            return n if done == -2 else -n - 1
    return len(keys)
