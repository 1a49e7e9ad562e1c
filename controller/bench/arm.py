"""An arm of the goal sets, in the form that methods receive."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm import arm as config
from hyperbit.controller.bench.goal_sets import load_arm
from hyperbit.controller.library import arm as library
from hyperbit.controller.library.obstacles import KINDS, Obstacle
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.workspace.cache import default_directory, load_or_map
from hyperbit.controller.workspace.densities import Densities

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BenchArm:
    """An arm of the goal sets, by the name of its file: B modules, each with at most K states and A actuators."""

    name: str
    model: config.Arm

    @cached_property
    def arm(self) -> library.Arm:
        return library.Arm._of(self.model)

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
        """Actuator states of each module state, padded with 0, shape (B, K, A)."""
        return self.model.manipulator.bits.copy()

    @property
    def bodies(self) -> tuple[Array, ...]:
        """Line segments of each module's structure for each state, in the frame below, B arrays (K, L, 2, 3)."""
        return tuple(module.body.copy() for module in self.model.manipulator.modules)

    @property
    def margin(self) -> float:
        """Least distance of a body's line from an obstacle without collision."""
        return self.clearance.margin

    @cached_property
    def obstacles(self) -> tuple[Obstacle, ...]:
        found: list[Obstacle] = []
        kind: Any
        for region in self.model.settings.obstacles:
            for kind, field in KINDS.items():
                if (shape := getattr(region, field)) is not None:
                    fields = {k: v for k, v in msgspec.to_builtins(shape).items() if v is not None}
                    found.append(kind(**fields, name=region.name))
        return tuple(found)

    @cached_property
    def clearance(self) -> BodyClearance:
        return self.model.clearance()

    @cached_property
    def densities(self) -> Densities:
        """Densities of the intermediate workspaces, from the cache or computed."""
        model = self.model
        return load_or_map(model.manipulator, model.pixel, model.level_pixels, default_directory())


def bench_arm(name: str) -> BenchArm:
    return BenchArm(name, load_arm(name))
