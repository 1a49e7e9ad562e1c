"""Neighbours of configurations: all configurations that serve a point and cost little from a given one.

A change sets modules to other states. The modules' changes are rigid motions of all that is above them, so a change of
several modules moves the tip by a product of them, the lowest module's last (meet in the middle): the upper modules'
changes move the tip to points, the inverse changes of the lower modules move the goal to points, and the two must meet.
"""

import numpy as np
from numba import boolean, float64, int64
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, I2, UNCOUNTED
from hyperbit.controller.obstacles.scene import Scene, for_scenes
from hyperbit.controller.search.neighbours.chain import CHAIN, PLACES, Chain, Places, moved, moved_back, state_of
from hyperbit.controller.search.neighbours.changes import (
    CHANGED,
    FOUND,
    Changed,
    Found,
    any_near,
    emit,
    move_all,
    prepare,
    put_motion,
    square_to,
)

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

ROUNDING = 1e-9  # relative rounding error of sums of weights
FEW, FEWER = 4096, 256  # points that are compared one by one; if several lower modules change. More are put into cells
CELL = 2.000001  # width of a cell in search radii: rounding must not put near points more than one cell apart


@kernel("i8(i8, i8, i8)", **UNCOUNTED, inline="always")
def hash_of(i: int, j: int, k: int) -> int:
    """Returns a hash of a cell's coordinates, at least 0."""
    return (i * 73856093 ^ j * 19349663 ^ k * 83492791) & 0x7FFFFFFF


@kernel(
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


@kernel(int64(CHANGED, int64, float64), **UNCOUNTED, error_model="numpy")
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


@kernel(
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


@kernel(
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


@kernel(
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
