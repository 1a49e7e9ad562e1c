"""A small arm, and the planner's core at a desk: an executor that the test plays, and workers that compute at once."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.program import FaultVerb, PlayableFaults
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities
from tests.planning.rig.desk import Desk
from tests.planning.rig.executor import ScriptedExecutor

MODULES = 4
DOCUMENT: dict[str, Any] = {
    "name": "small",
    "modules": [{"type": "vgt", "width": 0.2, "lengths": [0.2, 0.25], "count": MODULES}],
    "tolerance": {"position": 0.002},
    "travel_time": 0.05,
}
HOLD = 60.0  # [s], of the tracker
SIMULATION = PlayableFaults((FaultVerb("silence", "board", "", "disconnect it"),), ("can0/1",), ("can0",), ())
# A joint of three states has two actuators, and one pair of their states is no configuration.
JOINT = {"type": "transforms", "states": [{"position": [0.1, 0.05 * k]} for k in range(3)], "count": 2}


def unused_states(arm: Arm) -> int:
    """Returns the states of a joint's actuators that are no configuration."""
    used = {int(row @ [1, 2]) for row in arm.manipulator.modules[0].bits}
    return next(bits for bits in range(4) if bits not in used)


@pytest.fixture(scope="session")
def small(read: Callable[[Any], Arm]) -> Arm:
    return read(DOCUMENT)


@pytest.fixture(scope="session")
def small_densities(small: Arm) -> Densities:
    return map_densities(small.reduced, small.pixel, small.level_pixels)


@pytest.fixture
def desk(small: Arm, small_densities: Densities) -> Desk:
    desk = Desk(small, small_densities)
    desk.executor.greet()
    return desk


@pytest.fixture
def make_desk() -> Callable[..., Desk]:
    def make(arm: Arm, densities: Densities | None = None, **more: Any) -> Desk:
        desk = Desk(arm, densities or map_densities(arm.reduced, arm.pixel, arm.level_pixels), **more)
        desk.executor.greet()
        return desk

    return make


@pytest.fixture
def make_tracked(read: Callable[[Any], Arm], small_densities: Densities, make_desk: Callable[..., Desk]) -> Any:
    """Makes the desk of an arm whose tip is measured."""
    tracker = {"noise": 1e-4, "clamp": 0.01, "hold": HOLD}
    return lambda: make_desk(read({**DOCUMENT, "tracker": tracker}), small_densities)


@pytest.fixture
def make_simulated(small: Arm, small_densities: Densities, make_desk: Callable[..., Desk]) -> Any:
    return lambda: make_desk(small, small_densities, simulation=SIMULATION)


@pytest.fixture
def executor(tmp_path: Path) -> Iterator[ScriptedExecutor]:
    executor = ScriptedExecutor(tmp_path / "small.sock", 12)
    yield executor
    executor.close()
