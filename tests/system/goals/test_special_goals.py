"""Goals along lines, with a measured tip, and of an arm with other modules."""

import json
import time
from contextlib import ExitStack
from itertools import pairwise

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import LEFT, MIDDLE, RIGHT, tip
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually

pytestmark = pytest.mark.buses("virtual")

PATH = 0.03
POINTS, TIMES = (MIDDLE, (0.55, 2.8), LEFT), [0.0, 2.0, 5.0]  # slower on a slow machine


def on_the_line(t: float) -> np.ndarray:
    return np.array([np.interp(t / SLOWNESS, TIMES, column) for column in np.array(POINTS).T])


def test_the_tip_stays_by_the_lines_and_little_switches(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    client.move(MIDDLE)
    motions.clear()
    points = [{"t": t * SLOWNESS, "position": p} for t, p in zip(TIMES, POINTS, strict=True)]
    answer = client.ask("plan", waypoints=points, path_tolerance=PATH)
    told = answer["waypoints"]
    assert [w["t"] for w in told if not w["between"]] == [t * SLOWNESS for t in TIMES]
    for own, following in pairwise(told):
        for t in np.linspace(own["t"], following["t"], 9):
            assert np.linalg.norm(on_the_line(t) - own["position"]) <= PATH + 1e-9
    assert sum(w["switches"] > 0 for w in told) < len(told) / 2
    assert motions.still()
    before = boards.switches().sum()
    assert client.goal(*POINTS, times=TIMES, id="a", path_tolerance=PATH)["accepted"]
    result = client.result("a")
    assert result["status"] == "succeeded", result
    assert np.linalg.norm(tip(boards, arm) - LEFT) <= arm.tolerance
    motions.read()
    line = np.array([on_the_line(t) for t in np.linspace(0.0, TIMES[-1] * SLOWNESS, 500)])
    for row in motions.rows:
        at = arm.manipulator.tip(arm.manipulator.configuration(row))[:2, 3]
        assert np.linalg.norm(line - at, axis=1).min() <= PATH + 1e-3
    assert len(motions.rows) > 2
    feedback = client.last_feedback("a", 2)  # a busy machine may leave out others
    waypoints = [it["waypoint"] for it in feedback]
    assert (waypoints[-1], waypoints) == (2, sorted(set(waypoints)))
    assert sum(it["stages"] for it in feedback) <= result["switches"] == boards.switches().sum() - before
    assert len(motions.syncs) - len(motions.moved_at) <= len(POINTS), "what is held is not commanded again"


BIAS = np.array([0.012, -0.009])


@pytest.mark.arm(tracker={"noise": 1e-4, "clamp": 0.03})
def test_goals_are_met_where_the_tracker_sees_the_tip(
    client: Observer, system: System, arm: Arm, stack: ExitStack
) -> None:
    session, key = stack.enter_context(system.session()), f"hyperbit/{system.name}/measured_tip"

    def measure() -> bool:
        position = (np.array(client.state["tip"]["position"]) + BIAS).tolist()
        session.put(key, json.dumps({"stamp": time.time(), "position": position}))
        return bool(np.abs(np.array(client.state["bias"]) - BIAS).max() < 1e-4)

    blind = client.move(MIDDLE, goal="blind")
    assert blind["bias"] == [0.0, 0.0]
    assert np.linalg.norm(blind["position"] + BIAS - MIDDLE) > np.linalg.norm(BIAS) - arm.tolerance
    switched = client.wait_now("ready")["commanded"]
    eventually(measure)
    assert client.state["commanded"] == switched, "nothing moves because of a measured tip"
    answer = client.ask("plan", waypoints=[{"position": list(LEFT)}])
    assert answer["bias"] == pytest.approx(BIAS.tolist(), abs=2e-4)
    assert answer["waypoints"][0]["goal"] == pytest.approx(list(LEFT), abs=1e-12), "the goal that was asked for"
    for k, target in enumerate((LEFT, RIGHT, MIDDLE)):
        result = client.move(target, goal=f"seen {k}")
        at = np.array(result["position"])
        assert np.linalg.norm(at + BIAS - target) < arm.tolerance + 2e-4
        assert result["error"] == pytest.approx(np.linalg.norm(at + result["bias"] - target), abs=1e-9)
    tracker = client.diagnosed()["tracker"]
    assert tracker["accepted"] > 0
    assert tracker["bias"] == pytest.approx(BIAS.tolist(), abs=2e-4)


@pytest.mark.arm("mixed")
def test_goals_in_space_are_reached_by_the_boards(client: Observer, boards: Simulation, arm: Arm) -> None:
    m = arm.manipulator
    drawn = np.random.default_rng(5).integers(0, m.states, (3, len(m.states)))
    for k, goal in enumerate(m.tips(drawn)[:, :3, 3]):
        result = client.move(tuple(goal.tolist()), goal=f"goal {k}")
        at = m.tip(m.configuration(boards.positions().astype(np.uint8)))
        assert np.linalg.norm(at[:3, 3] - goal) <= arm.tolerance
        assert result["position"] == pytest.approx(at[:3, 3])
    assert client.ask("arm")["frames"] == [module.frames.tolist() for module in m.modules]
