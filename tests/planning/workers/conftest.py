"""Tables and scenes of the small arm, and where it starts."""

import json
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.decoding.goal import GoalMessage, parse
from hyperbit.controller.motion.decoding.requests import decode_obstacles
from hyperbit.controller.motion.stages.program import unpack_states
from hyperbit.controller.planning.core.tasks import (
    ArmStart,
    Basis,
    BuildScene,
    BuildTables,
    PlanGoal,
    Tables,
    VersionedScene,
)
from hyperbit.controller.planning.workers.computations import Abandoned, ArmModel, build_scene, build_tables
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities

HOME, A, B, C = (0, 0, 0, 0), (1, 2, 0, 0), (3, 4, 0, 1), (7, 0, 2, 0)

Disc = tuple[list[float], float]


def nothing() -> None:
    """A task goes on."""


def abandoned() -> None:
    raise Abandoned


class Bench:
    def __init__(self, arm: Arm, densities: Densities, locked: bytes | None = None) -> None:
        self.arm, self.densities, self.model = arm, densities, ArmModel(arm, "goals")
        self.actuators = len(arm.manipulator.actuators)
        self.weights = np.ones(self.actuators)
        task = BuildTables(1, bytes([255] * self.actuators) if locked is None else locked)
        self.tables: Tables = build_tables(arm, densities, self.weights, task)
        self._generations = count()
        self.free = self.scene()

    def scene(self, *discs: Disc) -> VersionedScene:
        regions = [{"disc": {"centre": centre, "radius": radius}} for centre, radius in discs]
        obstacles = decode_obstacles(json.dumps({"regions": regions}).encode(), 2)
        return build_scene(self.arm, BuildScene(next(self._generations), obstacles)).scene

    def packed(self, *configuration: int) -> bytes:
        states = self.arm.manipulator.actuator_states(np.array(configuration))
        return np.packbits(states, bitorder="little").tobytes()

    def states(self, packed: bytes) -> np.ndarray:
        return unpack_states(packed, self.actuators)

    def start(
        self, states: bytes | None = None, commanded: bytes | None = None, locked: bytes | None = None
    ) -> ArmStart:
        zeros = bytes((self.actuators + 7) // 8)
        states = zeros if states is None else states
        commanded = states if commanded is None else commanded
        return ArmStart(commanded, commanded, states, zeros if locked is None else locked)

    def tip(self, *configuration: int) -> list[float]:
        return self.arm.manipulator.tip(np.array(configuration))[:2, 3].tolist()  # type: ignore[no-any-return]

    def tip_of(self, packed: bytes) -> np.ndarray:
        return self.arm.manipulator.tip(self.arm.manipulator.configuration(self.states(packed)))[:2, 3]

    def goal(self, *positions: list[float], step: float = 0.2, **fields: Any) -> GoalMessage:
        waypoints = [{"t": step * k, "position": position} for k, position in enumerate(positions)]
        return parse(json.dumps({"id": "a", "waypoints": waypoints, **fields}).encode())

    def task(self, *configurations: tuple[int, ...], **changes: Any) -> PlanGoal:
        """A goal through the tips of configurations."""
        message = self.goal(*(self.tip(*c) for c in configurations))
        basis = self.basis(**{name: changes.pop(name) for name in Basis._fields if name in changes})
        return PlanGoal(message, 0.0, None, basis)._replace(**changes)

    def basis(self, **changes: Any) -> Basis:
        return Basis(self.start(), self.tables, self.free)._replace(**changes)

    def switches(self, start: bytes, stages: list[bytes]) -> int:
        rows = np.array([self.states(packed) for packed in [start, *stages]]).astype(int)
        return int(np.abs(np.diff(rows, axis=0)).sum())


@pytest.fixture
def bench(small: Arm, small_densities: Densities) -> Bench:
    return Bench(small, small_densities)


@pytest.fixture
def make_bench(read: Callable[[Any], Arm]) -> Callable[[dict[str, Any]], Bench]:
    def make(document: dict[str, Any]) -> Bench:
        arm = read(document)
        return Bench(arm, map_densities(arm.reduced, arm.pixel, arm.level_pixels))

    return make
