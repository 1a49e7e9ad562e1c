"""What the search keeps clear of, for its kernels: bodies are looked at as modules are set, or when a pair would do.

A guard is a tuple of arrays, with room for one configuration and the frames that it comes to, or None where there is
nothing to avoid. Kernels are compiled for both, so that what needs no guard does not pay for it.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.manipulator.frames import compose
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.clearance import ROUNDING, Clearance
from controller.obstacles.gaps import placed, touches
from controller.obstacles.touching import first_near
from controller.search.segment import Segment

Index = NDArray[np.int64]
Guard = tuple[Any, ...] | None
Pairs = tuple[Any, ...] | None

# Frames of the arm, bodies and regions, see Clearance; then room: states, frames F_0 to F_B, bodies in the world, and
# how many more configurations may be looked at.
GUARD = (
    "Tuple((f8[:,:,:,::1], f8[:,:,::1], f8[:,:,:,:,::1], f8[:,:,::1], i8[::1], i8[::1], f8[:,:,::1], f8[:,::1],"
    " f8[:,::1], f8, f8, i8[::1], f8[:,:,::1], f8[:,::1], f8[:,:,:,::1], f8[:,::1], i8[::1]))"
)
ROTATIONS, TRANSLATIONS, APART, STATES, TURNS, PLACES, LEFT = 0, 1, 10, 11, 12, 13, 16  # where in the guard they are
# A segment's first and last module, the rows that are asked for, and parents, modules and choices of all.
PART = "Tuple((i8, i8, i8[::1], i4[::1], i4[::1], i4[::1]))"
# The centre, what is known of the asking rows (nothing is noted where there is no room), the target and asking row that
# the room holds and whether they are clear, and the segments that meet.
PAIRS = f"Tuple(({GUARD}, i8[::1], i1[::1], i8[::1], {PART}, {PART}, {PART}))"
KINDS, PAIR_KINDS = ("none", GUARD), ("none", PAIRS)

CLEAR, BLOCKED = 1, 2
NOTHING_KNOWN = np.empty(0, dtype=np.int8)


def guard_of(manipulator: Manipulator, clearance: Clearance | None) -> Guard:
    """Returns what kernels need to keep an arm clear, with room of its own: one search at a time may use it."""
    if clearance is None or clearance.free:
        return None
    modules, regions = len(manipulator.modules), clearance.regions
    frames, places = np.empty((modules + 1, 3, 3)), np.empty((modules + 1, 3))
    frames[0], places[0] = manipulator.base[:3, :3], manipulator.base[:3, 3]
    return (
        manipulator.rotations,
        manipulator.translations,
        clearance.bodies,
        clearance.balls,
        clearance.lines,
        regions.kinds,
        regions.axes,
        regions.centres,
        regions.sizes,
        float(clearance.margin),
        2 * clearance.radius + ROUNDING * manipulator.length if clearance.self_collision else -1.0,
        np.zeros(modules, dtype=np.int64),
        frames,
        places,
        np.empty((modules, *clearance.bodies.shape[2:])),
        np.empty((modules, 4)),
        np.zeros(1, dtype=np.int64),
    )


def part(segment: Segment, rows: Index) -> tuple[Any, ...]:
    """Returns a segment as kernels take it; `rows` are the numbers of those that are asked for or asked."""
    return segment.first, segment.last, rows, segment.parents, segment.modules, segment.choices


def pairs_of(guard: Guard, centre: Configuration, parts: tuple[Any, Any, Any], known: NDArray[np.int8]) -> Pairs:
    """Returns what kernels need to see whether target, asking and asked row of three segments touch together.

    Args:
        guard: not None.
        centre: of the segments, shape (B,).
        parts: the segments, see part.
        known: of the asking rows, if they begin at the base, kept from one meeting to the next; or nothing.
    """
    return guard, centre, known, np.full(3, -1), *parts


def no_part() -> tuple[Any, ...]:
    """Returns a segment without modules."""
    none = np.zeros(1, dtype=np.int32)
    return 0, 0, np.zeros(1, dtype=np.int64), none, none, none


def buried(clearance: Clearance | None, point: NDArray[np.float64], tolerance: float) -> bool:
    """Returns whether wherever the tip is within a distance of a point (3,) in the world, it is in a region itself.

    That is sure only of last modules whose bodies hold the tip in every state.
    """
    if clearance is None or (clearance.regions.depths(point) > clearance.radius - tolerance).all():
        return False
    last = clearance.manipulator.modules[-1]
    for frame, lines in zip(last.frames, last.body, strict=True):
        along = lines[:, 1] - lines[:, 0]
        length = np.maximum((along**2).sum(axis=1), 1e-300)
        share = np.clip(((frame[:3, 3] - lines[:, 0]) * along).sum(axis=1) / length, 0.0, 1.0)
        away = np.linalg.norm(lines[:, 0] + share[:, None] * along - frame[:3, 3], axis=1)
        if away.min() > ROUNDING * clearance.manipulator.length / 2:
            return False
    return True


@njit(f"b1({GUARD}, i8)", cache=True, nogil=True, error_model="numpy")
def hits(guard: Any, i: int) -> bool:
    """Returns whether module i, in its state and on the frame that was reached, touches a region or a module below.

    With self-collision all modules below must have been asked for.
    """
    bodies, balls, lines, kinds, axes, centres, sizes, margin, apart, states, turns, places, ends, middles = guard[2:16]
    r, b, ball, body = turns[i], places[i], balls[i, states[i]], bodies[i, states[i], : lines[i]]
    if touches(r, b, body, ball, kinds, axes, centres, sizes, margin) >= 0:
        return True
    if apart < 0:
        return False
    for n in range(lines[i]):
        for end in range(2):
            ends[i, n, end, 0], ends[i, n, end, 1], ends[i, n, end, 2] = placed(r, b, body[n, end])
    middles[i, 0], middles[i, 1], middles[i, 2] = placed(r, b, ball[:3])
    middles[i, 3] = ball[3]
    return bool(first_near(ends, middles, lines, i, apart) >= 0)


@njit(f"void({GUARD}, i8)", cache=True, nogil=True)
def carry(guard: Any, i: int) -> None:
    """Writes the frame that module i, in its state, comes to."""
    s, t = guard[ROTATIONS][i, guard[STATES][i]], guard[TRANSLATIONS][i, guard[STATES][i]]
    turns, places = guard[TURNS], guard[PLACES]
    compose(turns[i], places[i], s, t, turns[i + 1], places[i + 1])


@njit(f"b1({GUARD}, i8, i8)", cache=True, nogil=True)
def blocked(guard: Any, first: int, last: int) -> bool:
    """Returns whether any of modules first+1 to last touches; on from the frame that was reached below them."""
    for i in range(first, last):
        if hits(guard, i):
            return True
        carry(guard, i)
    return False


@njit(f"void({GUARD}, i8, i8)", cache=True, nogil=True)
def stand(guard: Any, i: int, state: int) -> None:
    """Takes a state of module i that is known to be clear, and goes on to the frame that it comes to."""
    guard[STATES][i] = state
    if guard[APART] >= 0:
        hits(guard, i)  # to have its body in the world
    carry(guard, i)


@njit(f"void(i8[::1], i8[::1], {PART}, i8)", cache=True, nogil=True)
def put(states: Index, centre: Configuration, part: Any, n: int) -> None:
    """Puts the states of a segment's row, the n-th of those asked for, among those of the arm."""
    first, last, rows, parents, modules, choices = part
    for i in range(first, last):
        states[i] = centre[i]
    row = rows[n]
    while row > 0:
        states[modules[row]] = choices[row]
        row = parents[row]


@njit(f"b1({PAIRS}, i8, i8, i8)", cache=True, nogil=True)
def meets(pairs: Any, t: int, q: int, k: int) -> bool:
    """Returns whether the arm touches where target t, asking row q and asked row k are put together."""
    guard, centre, known, standing, targets, asking, asked = pairs
    states, below, last = guard[STATES], asking[1], len(centre)
    if asked[0] < below:  # the asked row begins at the base: nothing stays from one to the next
        put(states, centre, targets, t)
        put(states, centre, asking, q)
        put(states, centre, asked, k)
        return blocked(guard, 0, last)
    if standing[0] != t or standing[1] != q:
        put(states, centre, targets, t)
        put(states, centre, asking, q)
        standing[0], standing[1], standing[2] = t, q, BLOCKED if blocked(guard, 0, below) else CLEAR
        if len(known) > 0:
            known[q] = standing[2]
    if standing[2] == BLOCKED:
        return True
    put(states, centre, asked, k)
    return blocked(guard, below, last)


@njit(f"i8({GUARD}, i8[::1], {PART})", cache=True, nogil=True)
def first_clear(guard: Any, centre: Configuration, part: Any) -> int:
    """Returns which of the rows asked for, of a segment that is the whole arm, is the first that is clear; else -1."""
    for n in range(len(part[2])):
        put(guard[STATES], centre, part, n)
        if not blocked(guard, 0, len(centre)):
            return n
    return -1
