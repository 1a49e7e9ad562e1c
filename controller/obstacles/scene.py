"""Obstacles as the search's kernels take them: bodies are checked as modules are set, or when a match would do.

Kernels are compiled with a scene and without, so that an arm with nothing to avoid does not pay for it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, njit, types
from numpy.typing import NDArray

from controller.manipulator.frames import compose
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.clearance import Clearance
from controller.obstacles.collision import first_module
from controller.obstacles.distance import first_obstacle, placed

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# numba's names of arrays, by kind and dimensions, C-contiguous.
F2, F3, F4, F5 = float64[:, ::1], float64[:, :, ::1], float64[:, :, :, ::1], float64[:, :, :, :, ::1]
I1 = int64[::1]


class Scene(NamedTuple):
    """An arm among obstacles, with room for one configuration: one search at a time may use it.

    Attributes:
        rotations: configuration sets, shape (B, Kmax, 3, 3).
        translations: configuration sets, shape (B, Kmax, 3).
        bodies: and the next two: see Clearance.
        balls: see Clearance.
        lines: see Clearance.
        kinds: and the next three: see Regions.
        axes: see Regions.
        centres: see Regions.
        sizes: see Regions.
        margin: how near to an obstacle is too near.
        apart: how near modules may not come to each other; less than 0 if they may.
        states: room: the configuration, shape (B,).
        turns: room: rotations of frames F_0 to F_B in the world, shape (B + 1, 3, 3).
        places: room: their positions, shape (B + 1, 3).
        ends: room: bodies in the world, shape (B, Lmax, 2, 3).
        middles: room: balls in the world, shape (B, 4).
        checks: room: how many more configurations may be checked, shape (1,).
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
    turns: Array
    places: Array
    ends: Array
    middles: Array
    checks: Integers


PARTS = (F4, F3, F5, F3, I1, I1, F3, F2, F2, float64, float64, I1, F3, F2, F4, F2, I1)
SCENE = types.NamedTuple(PARTS, Scene)  # type: ignore[no-untyped-call]


def for_scenes(signature: Callable[[Any], Any]) -> list[Any]:
    """Returns the signatures of a kernel with a scene and without."""
    return [signature(types.none), signature(SCENE)]


def scene_of(manipulator: Manipulator, clearance: Clearance | None) -> Scene | None:
    """Returns the scene of an arm, None if there is nothing to avoid."""
    if clearance is None or clearance.free:
        return None
    modules, regions = len(manipulator.modules), clearance.regions
    turns, places = np.empty((modules + 1, 3, 3)), np.empty((modules + 1, 3))
    turns[0], places[0] = manipulator.base[:3, :3], manipulator.base[:3, 3]
    return Scene(
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
        float(clearance.apart),
        np.zeros(modules, dtype=np.int64),
        turns,
        places,
        np.empty((modules, *clearance.bodies.shape[2:])),
        np.empty((modules, 4)),
        np.zeros(1, dtype=np.int64),
    )


@njit(types.boolean(SCENE, int64), cache=True, nogil=True, error_model="numpy")
def module_collides(scene: Scene, i: int) -> bool:
    """Returns whether module i, in its state and on the frame below it, touches an obstacle or a module below.

    With self-collision, call it for all modules below first.
    """
    r, b, ball = scene.turns[i], scene.places[i], scene.balls[i, scene.states[i]]
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
    """Writes the frame above module i, in its state."""
    s, t = scene.rotations[i, scene.states[i]], scene.translations[i, scene.states[i]]
    compose(scene.turns[i], scene.places[i], s, t, scene.turns[i + 1], scene.places[i + 1])


@njit(types.boolean(SCENE, int64, int64), cache=True, nogil=True)
def segment_collides(scene: Scene, first: int, last: int) -> bool:
    """Returns whether any of modules first+1 to last touches, in their states, on the frame below them."""
    for i in range(first, last):
        if module_collides(scene, i):
            return True
        carry(scene, i)
    return False


@njit(types.boolean(SCENE, I1), cache=True, nogil=True)
def collides(scene: Scene, configuration: Configuration) -> bool:
    """Returns whether the arm touches anything in a configuration (B,)."""
    for i in range(len(configuration)):
        scene.states[i] = configuration[i]
    return bool(segment_collides(scene, 0, len(configuration)))


@njit(types.void(SCENE, int64, int64), cache=True, nogil=True)
def stand(scene: Scene, i: int, state: int) -> None:
    """Sets a state of module i that is known to be clear, and the frame above it."""
    scene.states[i] = state
    if scene.apart >= 0:
        module_collides(scene, i)  # writes its body in the world
    carry(scene, i)
