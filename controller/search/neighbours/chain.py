"""An arm and the points of a trajectory for kernels; configurations as keys, and what they serve."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numba import boolean, float64, int64
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.frame_kernels import tip as tip_of
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, F4, I1, I2, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.scene import Scene, collides, for_scenes
from hyperbit.controller.search.lists.segment import compose, motions
from hyperbit.controller.search.method import costs_between_states
from hyperbit.controller.search.target import SLACK, SearchTarget, within

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Index32 = NDArray[np.int32]
Flags = NDArray[np.bool_]
Point = tuple[float, float, float]

WORD = 63  # bits of a word of a key
BLUR = 4e-6  # rounding error of points in single precision, relative to the arm's length


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
    base: Array  # frame F_0 in the world, shape (4, 4)
    frames: Array  # configuration sets, shape (B, Kmax, 4, 4)


class Places(NamedTuple):
    """The points of a trajectory. Radii and chords have some slack for rounding, see `serves`."""

    positions: Array  # in frame F_0, shape (n, 3)
    rotations: Array  # in frame F_0; cos and sin, or row by row, shape (n, 2) or (n, 9)
    radii: Array  # distances above which no tip is within the tolerance, shape (n,)
    sure_radii: Array  # distances below which each is, shape (n,)
    chords: Array  # the same of squared chords; infinite without orientation, shape (n,)
    sure_chords: Array  # shape (n,)
    goals: Array  # frames in the world, shape (n, 4, 4)
    tolerances: Array  # of the distances, shape (n,)
    turns: Array  # tolerances of the angles [rad]; infinite without orientation, shape (n,)
    fixed: Flags  # whether a point is given as a configuration, shape (n,)
    given: Integers  # its key, shape (n, words)


CHAIN = named(Chain, F2, I1, F3, I1, I1, I1, float64, boolean, float64, F2, F4)
PLACES = named(Places, F2, F2, F1, F1, F1, F1, F3, F1, F1, boolean[::1], I2)
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
    m, costs, blur = manipulator, costs_between_states(manipulator, weights), BLUR * manipulator.length
    return Chain(motions(m), m.states, costs, *places, masks, least, whole, blur, m.base, m.frames)


def places_of(chain: Chain, points: Iterable[tuple[SearchTarget, Configuration | None]]) -> Places:
    """Returns points for kernels, each with its target, and its configuration if that is given."""
    targets, configurations = zip(*points, strict=True)
    size = 2 if chain.motions.shape[1] == 4 else 3
    given = np.zeros((len(targets), int(chain.words[-1]) + 1), np.int64)
    for row, configuration in zip(given, configurations, strict=True):
        if configuration is not None:
            row[:] = keys_of(chain, configuration)[0]
    radii, tolerances = np.array([(target.radius, target.tolerance) for target in targets]).T.copy()
    chords = np.array([target.chord if target.oriented else np.inf for target in targets])
    return Places(
        np.array([target.position for target in targets]),
        np.array([target.row[size:] for target in targets]),
        radii,
        np.maximum(2 * tolerances - radii, 0.0),
        chords,
        chords - 2 * SLACK,
        np.array([target.goal for target in targets]),
        tolerances,
        np.array([target.angle_tolerance if target.oriented else np.inf for target in targets]),
        np.array([configuration is not None for configuration in configurations]),
        given,
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
    return np.ascontiguousarray((keys[:, chain.words] >> chain.shifts) & chain.masks)


@kernel(int64(CHAIN, I2, int64, int64), **UNCOUNTED, inline="always")
def state_of(chain: Chain, keys: Integers, n: int, i: int) -> int:
    """Returns the state of module i in keys[n]."""
    return int((keys[n, chain.words[i]] >> chain.shifts[i]) & chain.masks[i])


@kernel(MOVED, **UNCOUNTED, inline="always")
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


@kernel(MOVED, **UNCOUNTED, inline="always")
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


@kernel(int64(CHAIN, I2, int64, F2), **UNCOUNTED)
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


@kernel(boolean(CHAIN, PLACES, int64, I2, int64))
def serves_on_edge(chain: Chain, places: Places, k: int, keys: Integers, n: int) -> bool:
    """Returns whether keys[n] serves point k, a position or pose, by `within`."""
    configuration = np.empty(len(chain.states), np.int64)
    for i in range(len(configuration)):
        configuration[i] = state_of(chain, keys, n, i)
    tip = tip_of(chain.base, chain.frames, configuration)
    return bool(within(tip, places.goals[k], places.tolerances[k], places.turns[k]))


@kernel(boolean(CHAIN, PLACES, int64, F2, int64, I2, int64), **UNCOUNTED)
def serves(chain: Chain, places: Places, k: int, tips: Array, tip: int, keys: Integers, n: int) -> bool:
    """Returns whether keys[n], whose tip is tips[tip], serves point k. Where rounding might decide, `within` does."""
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
        chord *= 1.0 if size == 2 else 0.5
        if chord > places.chords[k]:
            return False
    sure = square < places.sure_radii[k] ** 2 and chord < places.sure_chords[k]
    return bool(sure or serves_on_edge(chain, places, k, keys, n))


@kernel(
    for_scenes(lambda scene: boolean(CHAIN, PLACES, int64, scene, F2, I2, int64, I1)),
    **UNCOUNTED,
)
def fits(
    chain: Chain, places: Places, k: int, scene: Scene | None, frames: Array, keys: Integers, n: int, states: Integers
) -> bool:
    """Returns whether keys[n] serves point k and is clear; the last two frames and states (B,) are scratch."""
    if not serves(chain, places, k, frames, write_tip(chain, keys, n, frames), keys, n):
        return False
    if scene is not None:
        for i in range(len(states)):
            states[i] = state_of(chain, keys, n, i)
        return not collides(scene, states)
    return True
