"""A tracker that sees the tip beside where the daemon computes it, and goals that are met all the same."""

import json
import time
from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from controller.config import Arm
from controller.daemon.service import Daemon
from controller.settings import TrackerSettings
from drivers.simulation.simulation import Simulation
from drivers.wiring import Timing
from tests.daemon.waiting import eventually
from tests.integration.conftest import Bench, enduring
from tests.integration.harness import Observer
from tests.integration.test_goals import LEFT, MIDDLE, RIGHT

BIAS = np.array([0.012, -0.009])

pytestmark = pytest.mark.buses("virtual")


@pytest.fixture
def daemon(bench: Bench, boards: Simulation, timing: Timing) -> Daemon:
    """A daemon with a tracker, patient with boards which a loaded machine keeps waiting."""
    tracker = TrackerSettings(noise=1e-4, clamp=0.03)
    bench.arm = replace(bench.arm, settings=msgspec.structs.replace(bench.arm.settings, tracker=tracker))
    return bench.run(enduring(timing))


@pytest.fixture
def track(bench: Bench, client: Observer, arm: Arm) -> Callable[[], None]:
    """Measures the tip, as it really is, until the daemon knows its bias."""
    session = bench.session()

    def measure() -> bool:
        state = client.heard["state"][-1]
        position = (np.array(state["tip"]["position"]) + BIAS).tolist()
        session.put(
            f"hyperbit/{arm.settings.name}/measured_tip", json.dumps({"stamp": time.time(), "position": position})
        )
        return bool(np.abs(np.array(state["bias"]) - BIAS).max() < 1e-4)

    return lambda: eventually(measure)


def seen(result: dict) -> np.ndarray:
    """Where a tracker sees the tip of a result."""
    return np.array(result["position"]) + BIAS


def test_goals_are_met_where_the_tracker_sees_the_tip(client: Observer, track: Callable[[], None], arm: Arm) -> None:
    blind = client.move(MIDDLE, goal="blind")
    assert blind["bias"] == [0.0, 0.0]
    assert np.linalg.norm(seen(blind) - MIDDLE) > np.linalg.norm(BIAS) - arm.tolerance
    switched = client.heard["state"][-1]["commanded"]
    track()
    assert client.heard["state"][-1]["commanded"] == switched  # nothing moves because of a measured tip
    for k, target in enumerate((LEFT, RIGHT, MIDDLE)):
        result = client.move(target, goal=f"seen {k}")
        assert np.linalg.norm(seen(result) - target) < arm.tolerance + 2e-4
        assert result["error"] == pytest.approx(
            np.linalg.norm(np.array(result["position"]) + result["bias"] - target), abs=1e-9
        )
    told = len(client.heard["diagnostics"])
    tracker = eventually(lambda: client.heard["diagnostics"][told:])[0]["tracker"]
    assert tracker["accepted"] > 0
    assert tracker["bias"] == pytest.approx(BIAS.tolist(), abs=2e-4)


def test_a_plan_names_the_goal_that_was_asked_for(client: Observer, track: Callable[[], None]) -> None:
    client.move(LEFT)
    track()
    answer = client.ask("plan", waypoints=[{"position": list(MIDDLE)}])
    assert answer["bias"] == pytest.approx(BIAS.tolist(), abs=2e-4)
    assert answer["waypoints"][0]["goal"] == pytest.approx(list(MIDDLE), abs=1e-12)
