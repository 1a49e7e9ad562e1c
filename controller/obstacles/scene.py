"""Collision checks inside the search's kernels: module by module in a descent, or whole configurations.

Each kernel is compiled with and without a scene, so that a search without obstacles runs at full speed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.frame_kernels import compose
from hyperbit.controller.manipulator.kernel_types import F2, F3, I1, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.collision import ARM_BODIES, WORLD_BODIES, ArmBodies, WorldBodies, first_touch
from hyperbit.controller.obstacles.distance import SURROUNDINGS, Surroundings

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Scene(NamedTuple):
    """An arm among obstacles, with scratch arrays for one configuration. Only one search at a time may use it."""

    arm: ArmBodies  # frames and bodies
    surroundings: Surroundings  # what the arm must not touch
    states: Integers  # scratch: the configuration, shape (B,)
    frame_rotations: Array  # scratch: rotations of frames F_0 to F_B in the world, shape (B + 1, 3, 3)
    positions: Array  # scratch: positions of frames F_0 to F_B in the world, shape (B + 1, 3)
    world: WorldBodies  # scratch: bodies in the world
    # scratch: number of configurations that may still be checked, and number of those checked so far, shape (2,)
    checks: Integers


SCENE = named(Scene, ARM_BODIES, SURROUNDINGS, I1, F3, F2, WORLD_BODIES, I1)


def for_scenes(signature: Callable[[Any], Any]) -> list[Any]:
    """Returns the signatures of a kernel with a scene and without."""
    return [signature(types.none), signature(SCENE)]


def scene_of(manipulator: Manipulator, clearance: BodyClearance | None) -> Scene | None:
    """Returns the scene of an arm, or None if it has nothing to avoid."""
    if clearance is None or clearance.free:
        return None
    modules = len(manipulator.modules)
    rotations, positions = np.empty((modules + 1, 3, 3)), np.empty((modules + 1, 3))
    rotations[0], positions[0] = manipulator.base[:3, :3], manipulator.base[:3, 3]
    return Scene(
        clearance.arm_bodies,
        clearance.surroundings,
        np.zeros(modules, dtype=np.int64),
        rotations,
        positions,
        WorldBodies(np.empty((modules, *clearance.bodies.shape[2:])), np.empty((modules, 4))),
        np.zeros(2, dtype=np.int64),
    )


@kernel(types.boolean(SCENE, int64), **UNCOUNTED, error_model="numpy")
def module_collides(scene: Scene, i: int) -> bool:
    """Returns whether module i, in its state and on the frame below it, touches an obstacle or a module below.

    With self-collision, call in order, base to tip.
    """
    r, b = scene.frame_rotations[i], scene.positions[i]
    obstacle, other = first_touch(scene.arm, scene.surroundings, i, scene.states[i], r, b, scene.world)
    return bool(obstacle >= 0 or other >= 0)


@kernel(types.void(SCENE, int64), **UNCOUNTED)
def carry(scene: Scene, i: int) -> None:
    """Writes the frame above module i for its state."""
    s, t = scene.arm.rotations[i, scene.states[i]], scene.arm.translations[i, scene.states[i]]
    r, b = scene.frame_rotations, scene.positions
    compose(r[i], b[i], s, t, r[i + 1], b[i + 1])


@kernel(types.boolean(SCENE, int64, int64), **UNCOUNTED)
def segment_collides(scene: Scene, first: int, last: int) -> bool:
    """Returns whether any of modules first+1 to last collides, in their states, on the frame below them."""
    for i in range(first, last):
        if module_collides(scene, i):
            return True
        carry(scene, i)
    return False


@kernel(types.boolean(SCENE, I1), **UNCOUNTED)
def collides(scene: Scene, configuration: Configuration) -> bool:
    """Returns whether the arm collides in a configuration (B,)."""
    for i in range(len(configuration)):
        scene.states[i] = configuration[i]
    return bool(segment_collides(scene, 0, len(configuration)))


@kernel(types.void(SCENE, int64, int64), **UNCOUNTED)
def set_state(scene: Scene, i: int, state: int) -> None:
    """Sets a state of module i that is known to be clear, and writes the frame above it."""
    scene.states[i] = state
    if scene.surroundings.apart >= 0:
        module_collides(scene, i)  # for its side effect: it writes the body in the world
    carry(scene, i)
