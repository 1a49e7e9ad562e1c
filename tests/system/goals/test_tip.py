"""A tracker measures the tip beside its computed position; goals are still reached."""

import json
import time
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from tests.system.stack.observer import Observer
from tests.system.stack.places import LEFT, MIDDLE, RIGHT
from tests.system.stack.system import System
from tests.waiting import eventually

BIAS = np.array([0.012, -0.009])

pytestmark = [pytest.mark.arm(tracker={"noise": 1e-4, "clamp": 0.03}), pytest.mark.buses("virtual")]


@pytest.fixture
def track(client: Observer, system: System, stack: ExitStack) -> Callable[[np.ndarray], None]:
    """Measures the tip with a bias until the daemon knows the bias."""
    session, key = stack.enter_context(system.session()), f"hyperbit/{system.name}/measured_tip"

    def track(bias: np.ndarray) -> None:
        def measure() -> bool:
            position = (np.array(client.state["tip"]["position"]) + bias).tolist()
            session.put(key, json.dumps({"stamp": time.time(), "position": position}))
            return bool(np.abs(np.array(client.state["bias"]) - bias).max() < 1e-4)

        eventually(measure)

    return track


def seen(result: dict) -> np.ndarray:
    """The tip of a result, as a tracker measures it."""
    return np.array(result["position"]) + BIAS


def test_goals_are_met_where_the_tracker_sees_the_tip(
    client: Observer, track: Callable[[np.ndarray], None], arm: Arm
) -> None:
    blind = client.move(MIDDLE, goal="blind")
    assert blind["bias"] == [0.0, 0.0]
    assert np.linalg.norm(seen(blind) - MIDDLE) > np.linalg.norm(BIAS) - arm.tolerance
    switched = client.wait_now("ready")["commanded"]
    track(BIAS)
    assert client.state["commanded"] == switched, "nothing moves because of a measured tip"
    answer = client.ask("plan", waypoints=[{"position": list(LEFT)}])
    assert answer["bias"] == pytest.approx(BIAS.tolist(), abs=2e-4)
    assert answer["waypoints"][0]["goal"] == pytest.approx(list(LEFT), abs=1e-12), "the goal that was asked for"
    for k, target in enumerate((LEFT, RIGHT, MIDDLE)):
        result = client.move(target, goal=f"seen {k}")
        assert np.linalg.norm(seen(result) - target) < arm.tolerance + 2e-4
        assert result["error"] == pytest.approx(
            np.linalg.norm(np.array(result["position"]) + result["bias"] - target), abs=1e-9
        )
    tracker = client.diagnosed()["tracker"]
    assert tracker["accepted"] > 0
    assert tracker["bias"] == pytest.approx(BIAS.tolist(), abs=2e-4)
