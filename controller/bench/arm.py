"""An arm as the benchmark hands it to methods."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from controller import config
from controller.bench.goal_sets import arm_path, load_arm
from controller.library import arm as library
from controller.library.obstacles import KINDS, Obstacle
from controller.obstacles.clearance import Clearance
from controller.workspace.cache import default_directory, load_or_map
from controller.workspace.densities import Densities

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BenchArm:
    """An arm of the goal sets. B modules of at most K states, each with at most A actuators.

    Attributes:
        name: of its file.
        path: of its file.
    """

    name: str
    path: Path

    @cached_property
    def arm(self) -> library.Arm:
        """The arm as the library `hyperbit` has it, obstacles included."""
        return library.load(self.path)

    @property
    def states(self) -> NDArray[np.int64]:
        """Number of states of each module, shape (B,)."""
        return self.model.manipulator.states.copy()

    @property
    def base(self) -> Array:
        """Frame of the base in the world, shape (4, 4)."""
        return self.model.manipulator.base.copy()

    @property
    def frames(self) -> Array:
        """Frame of the next module for each state, padded with identities, shape (B, K, 4, 4).

        The tip's frame of a configuration c is base @ frames[0, c[0]] @ ... @ frames[B - 1, c[B - 1]].
        """
        return self.model.manipulator.frames.copy()

    @property
    def bits(self) -> NDArray[np.uint8]:
        """Actuator states of each state, padded with 0, shape (B, K, A): switches are the places that differ."""
        return self.model.manipulator.bits.copy()

    @property
    def bodies(self) -> tuple[Array, ...]:
        """Line segments of each module's structure for each state, in the frame below, B arrays (K, L, 2, 3)."""
        return tuple(module.body.copy() for module in self.model.manipulator.modules)

    @property
    def margin(self) -> float:
        """Distance of a body's line from an obstacle that counts as touching."""
        return self.clearance.margin

    @cached_property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """What no body may touch."""
        found: list[Obstacle] = []
        kind: Any
        for region in self.model.settings.obstacles:
            for kind, field in KINDS.items():
                if (shape := getattr(region, field)) is not None:
                    fields = {k: v for k, v in msgspec.to_builtins(shape).items() if v is not None}
                    found.append(kind(**fields, name=region.name))
        return tuple(found)

    @property
    def model(self) -> config.Arm:
        """The arm as the product's rooms have it."""
        return load_arm(self.name)

    @cached_property
    def clearance(self) -> Clearance:
        """What decides whether an answer touches an obstacle."""
        return self.model.clearance()

    @cached_property
    def densities(self) -> Densities:
        """Densities of the intermediate workspaces, from the cache or mapped."""
        model = self.model
        return load_or_map(model.manipulator, model.pixel, model.level_pixels, default_directory())


def bench_arm(name: str) -> BenchArm:
    """Returns an arm of the goal sets."""
    return BenchArm(name, arm_path(name))
