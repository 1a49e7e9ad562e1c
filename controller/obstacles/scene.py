"""Collision checks inside the search's kernels: module by module in a descent, or whole configurations.

Each kernel is compiled with and without a scene, so that a search without obstacles runs at full speed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, njit, types
from numpy.typing import NDArray

from controller.manipulator.frame_kernels import compose
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.clearance import Clearance
from controller.obstacles.collision import first_module
from controller.obstacles.distance import first_obstacle, placed

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# numba's types of C-contiguous arrays: F2 is float64 with two dimensions, I1 is int64 with one.
F2, F3, F4, F5 = float64[:, ::1], float64[:, :, ::1], float64[:, :, :, ::1], float64[:, :, :, :, ::1]
I1 = int64[::1]


class Scene(NamedTuple):
    """An arm among obstacles, with scratch arrays for one configuration. Only one search at a time may use it.

    Attributes:
        rotations: configuration sets, shape (B, Kmax, 3, 3).
        translations: configuration sets, shape (B, Kmax, 3).
        bodies: see Clearance.
        balls: see Clearance.
        lines: see Clearance.
        kinds: see Obstacles.
        axes: see Obstacles.
        centres: see Obstacles.
        sizes: see Obstacles.
        margin: distance from an obstacle that counts as touching.
        apart: distance between modules that counts as touching; negative without self-collision.
        states: scratch: the configuration, shape (B,).
        frame_rotations: scratch: rotations of frames F_0 to F_B in the world, shape (B + 1, 3, 3).
        positions: scratch: positions of frames F_0 to F_B in the world, shape (B + 1, 3).
        ends: scratch: bodies in the world, shape (B, Lmax, 2, 3).
        middles: scratch: balls in the world, shape (B, 4).
        checks: scratch: number of configurations that may still be checked, shape (1,).
    """

    rotations: Array
    translations: Array
    bodies: Array
    balls: Array
    lines: Integers
    kinds: Integers
    axes: Array
    centres: Array
    sizes: Array
    margin: float
    apart: float
    states: Integers
    frame_rotations: Array
    positions: Array
    ends: Array
    middles: Array
    checks: Integers


PARTS = (F4, F3, F5, F3, I1, I1, F3, F2, F2, float64, float64, I1, F3, F2, F4, F2, I1)
SCENE = types.NamedTuple(PARTS, Scene)  # type: ignore[no-untyped-call]


def for_scenes(signature: Callable[[Any], Any]) -> list[Any]:
    """Returns the signatures of a kernel with a scene and without."""
    return [signature(types.none), signature(SCENE)]


def scene_of(manipulator: Manipulator, clearance: Clearance | None) -> Scene | None:
    """Returns the scene of an arm, or None if it has nothing to avoid."""
    if clearance is None or clearance.free:
        return None
    modules, obstacles = len(manipulator.modules), clearance.obstacles
    rotations, positions = np.empty((modules + 1, 3, 3)), np.empty((modules + 1, 3))
    rotations[0], positions[0] = manipulator.base[:3, :3], manipulator.base[:3, 3]
    return Scene(
        manipulator.rotations,
        manipulator.translations,
        clearance.bodies,
        clearance.balls,
        clearance.lines,
        obstacles.kinds,
        obstacles.axes,
        obstacles.centres,
        obstacles.sizes,
        float(clearance.margin),
        float(clearance.apart),
        np.zeros(modules, dtype=np.int64),
        rotations,
        positions,
        np.empty((modules, *clearance.bodies.shape[2:])),
        np.empty((modules, 4)),
        np.zeros(1, dtype=np.int64),
    )


@njit(types.boolean(SCENE, int64), cache=True, nogil=True, error_model="numpy")
def module_collides(scene: Scene, i: int) -> bool:
    """Returns whether module i, in its state and on the frame below it, touches an obstacle or a module below.

    With self-collision, call in order, base to tip.
    """
    r, b, ball = scene.frame_rotations[i], scene.positions[i], scene.balls[i, scene.states[i]]
    body = scene.bodies[i, scene.states[i], : scene.lines[i]]
    if first_obstacle(r, b, body, ball, scene.kinds, scene.axes, scene.centres, scene.sizes, scene.margin) >= 0:
        return True
    if scene.apart < 0:
        return False
    ends, middles = scene.ends, scene.middles
    for n in range(scene.lines[i]):
        for end in range(2):
            ends[i, n, end, 0], ends[i, n, end, 1], ends[i, n, end, 2] = placed(r, b, body[n, end])
    middles[i, 0], middles[i, 1], middles[i, 2] = placed(r, b, ball[:3])
    middles[i, 3] = ball[3]
    return bool(first_module(ends, middles, scene.lines, i, scene.apart) >= 0)


@njit(types.void(SCENE, int64), cache=True, nogil=True)
def carry(scene: Scene, i: int) -> None:
    """Writes the frame above module i for its state."""
    s, t = scene.rotations[i, scene.states[i]], scene.translations[i, scene.states[i]]
    r, b = scene.frame_rotations, scene.positions
    compose(r[i], b[i], s, t, r[i + 1], b[i + 1])


@njit(types.boolean(SCENE, int64, int64), cache=True, nogil=True)
def segment_collides(scene: Scene, first: int, last: int) -> bool:
    """Returns whether any of modules first+1 to last collides, in their states, on the frame below them."""
    for i in range(first, last):
        if module_collides(scene, i):
            return True
        carry(scene, i)
    return False


@njit(types.boolean(SCENE, I1), cache=True, nogil=True)
def collides(scene: Scene, configuration: Configuration) -> bool:
    """Returns whether the arm collides in a configuration (B,)."""
    for i in range(len(configuration)):
        scene.states[i] = configuration[i]
    return bool(segment_collides(scene, 0, len(configuration)))


@njit(types.void(SCENE, int64, int64), cache=True, nogil=True)
def set_state(scene: Scene, i: int, state: int) -> None:
    """Sets a state of module i that is known to be clear, and writes the frame above it."""
    scene.states[i] = state
    if scene.apart >= 0:
        module_collides(scene, i)  # for its side effect: it writes the body in the world
    carry(scene, i)
