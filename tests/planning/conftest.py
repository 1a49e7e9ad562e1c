"""A small arm, and a planner connected to an executor that the test plays."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller.config import Arm
from controller.planning.link import ExecutorLink
from controller.planning.planning import Planning
from controller.program import Hello, unpack
from controller.workspace.densities import Densities
from controller.workspace.mapping import map_densities
from tests.planning.executor import DIGEST, FakeLedger, Inbox, ScriptedExecutor
from tests.waiting import eventually

MODULES = 4
DOCUMENT: dict[str, Any] = {
    "name": "small",
    "modules": [{"type": "vgt", "width": 0.2, "lengths": [0.2, 0.25], "count": MODULES}],
    "tolerance": {"position": 0.002},
    "travel_time": 0.05,
}


@pytest.fixture(scope="session")
def small(read: Callable[[Any], Arm]) -> Arm:
    return read(DOCUMENT)


@pytest.fixture(scope="session")
def small_densities(small: Arm) -> Densities:
    return map_densities(small.reduced, small.pixel, small.level_pixels)


class Desk:
    """The planner, its published payloads, and its executor."""

    def __init__(self, arm: Arm, densities: Densities, folder: Path) -> None:
        self.arm, self.inbox = arm, Inbox()
        self.actuators = len(arm.manipulator.actuators)
        self.ledger = FakeLedger(self.actuators)
        path = folder / "small.sock"
        self.executor = ScriptedExecutor(path, self.actuators)
        self.link = ExecutorLink(path, "small", DIGEST)
        self.planning = Planning(arm, densities, self.link, self.ledger, self.inbox.put)

    def start(self) -> None:
        self.planning.start()
        self.executor.expect(Hello)
        self.settle()

    def settle(self) -> None:
        """Waits until the planner has received the executor's latest snapshot."""
        eventually(lambda: self.link.snapshot == self.executor.state and self.planning._monitor.state is not None)

    def show(self, **changes: Any) -> None:
        self.executor.show(**changes)
        self.settle()

    def close(self) -> None:
        self.executor.close()
        self.planning.close()

    # --- goals

    def tip(self, *configuration: int) -> list[float]:
        return self.arm.manipulator.tip(np.array(configuration))[:2, 3].tolist()  # type: ignore[no-any-return]

    def bits(self, *configuration: int) -> int:
        states = self.arm.manipulator.actuator_states(np.array(configuration))
        return sum(int(s) << k for k, s in enumerate(states))

    def goal(self, *configurations: tuple[int, ...], step: float = 0.2, name: str = "a", **fields: Any) -> None:
        """Sends a goal whose waypoints are the tips of configurations."""
        waypoints = [{"t": step * k, "position": self.tip(*c)} for k, c in enumerate(configurations)]
        self.raw({"id": name, "waypoints": waypoints, **fields})

    def raw(self, payload: Any) -> None:
        self.planning.goal(json.dumps(payload).encode(), self.inbox.replying())

    @property
    def outputs(self) -> int:
        return unpack(self.executor.state.outputs)


@pytest.fixture
def desk(small: Arm, small_densities: Densities, tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(small, small_densities, tmp_path)
    desk.start()
    yield desk
    desk.close()


@pytest.fixture
def make_desk(tmp_path: Path) -> Iterator[Callable[..., Desk]]:
    """Builds a desk of another arm."""
    made: list[Desk] = []

    def make(arm: Arm, densities: Densities | None = None) -> Desk:
        found = densities or map_densities(arm.reduced, arm.pixel, arm.level_pixels)
        folder = tmp_path / str(len(made))
        folder.mkdir()
        made.append(Desk(arm, found, folder))
        made[-1].start()
        return made[-1]

    yield make
    for desk in made:
        desk.close()
