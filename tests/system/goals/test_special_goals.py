"""Goals along lines, with locked actuators, with a measured tip, and of an arm with other modules."""

import json
import time
from contextlib import ExitStack
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.notation import format_configuration
from hyperbit.controller.network.client import Message
from hyperbit.controller.refusals import codes
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.arms import QUICK
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import LEFT, MIDDLE, RIGHT, first_to_switch, tip
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


def test_lines_that_cannot_be_followed_are_refused_in_words(client: Observer, motions: Motions) -> None:
    short = f"{0.3 * SLOWNESS:g} s for a line of 0.15 within path_tolerance"
    ends = (-2.6, 1.5), (2.6, 1.5)  # the straight line between them is out of reach
    for points, last, tolerance, code, words in (
        ((MIDDLE, LEFT), 0.3, 0.01, codes.INVALID_GOAL, f"waypoints[0] to waypoints[1]: {short}"),
        (ends, 60.0, 0.05, codes.GOAL_TOLERANCE_VIOLATED, "waypoints[0] to waypoints[1]: ("),
        ((MIDDLE, LEFT), 60.0, 0, codes.INVALID_GOAL, "path_tolerance: "),
    ):
        answer = client.goal(*points, times=[0.0, last], id="a", path_tolerance=tolerance)
        assert (answer["accepted"], answer["code"]) == (False, code)
        assert answer["message"].startswith(words), answer
    assert motions.still()


NEAR = (0.3, 2.8)
LOCKING = pytest.mark.arm(on_stuck="continue", boards=QUICK)


def locked(client: Observer, actuators: list[Any]) -> Message:
    """Waits for a state of a ready arm with exactly these locked actuators; returns it."""
    return eventually(lambda: s if (s := client.wait_now("ready"))["degraded"] == actuators else None)


@LOCKING
def test_goals_go_on_without_a_stuck_actuator_and_with_it_when_it_is_repaired(
    client: Observer, boards: Simulation, arm: Arm
) -> None:
    client.move(MIDDLE)
    label, state_now = first_to_switch(client, arm, RIGHT)
    k = arm.manipulator.actuators.index(label)
    boards.fault("stick", label, state_now)
    before = len(client.heard["state"])
    client.goal(RIGHT, id="a")
    assert (client.result("a")["status"], label in client.result("a")["message"]) == ("aborted", True)
    client.wait_for("fault", label, after=before)
    state = client.wait_now("ready")
    assert state["degraded"] == [{"actuator": label, "state": state_now}]
    assert [(fault["code"], fault["source"]) for fault in state["faults"]] == [("degraded", label)]
    assert state["measured"] == boards.positions().astype(int).tolist()
    tried = int(boards.switches()[k])
    for number, goal in enumerate((LEFT, MIDDLE, NEAR, LEFT)):
        client.move(goal, goal=f"b{number}")
        assert np.linalg.norm(tip(boards, arm) - goal) <= arm.tolerance
        state = client.wait_now("ready")
        assert state["commanded"][k] == state["measured"][k] == state_now
        assert boards.switches()[k] == tried + 1, "the first goal takes its output back to where it is stuck"
    refused = client.goal(RIGHT)
    assert (refused["code"], "out of reach" in refused["message"]) == (codes.GOAL_TOLERANCE_VIOLATED, True)
    boards.fault("release", label)
    assert client.ask("degrade", actuator=label, state=None)["accepted"]
    assert locked(client, [])["faults"] == []
    client.move(RIGHT, goal="c")


@LOCKING
def test_an_actuator_that_an_operator_locks_is_left_as_it_is_and_nothing_moves_by_that(
    client: Observer, boards: Simulation, arm: Arm
) -> None:
    client.move(MIDDLE)
    label, state_now = first_to_switch(client, arm, RIGHT)
    k, before = arm.manipulator.actuators.index(label), boards.switches().tolist()
    malformed = client.ask("degrade")
    assert (malformed["accepted"], malformed["message"][:9]) == (False, "actuator:")
    refused = client.ask("degrade", actuator=label, state=1 - state_now)
    assert (refused["accepted"], f"the end-stop of {label} reads" in refused["message"]) == (False, True)
    assert client.ask("degrade", actuator=label, state=state_now)["accepted"]
    locked(client, [{"actuator": label, "state": state_now}])
    assert boards.switches().tolist() == before
    client.move(LEFT, NEAR, goal="b")
    assert boards.switches()[k] == before[k]
    jogged = client.ask("jog", actuators={label: ("extended", "contracted")[state_now]})
    assert (jogged["accepted"], label in jogged["message"]) == (False, True)
    assert client.ask("degrade", actuator=label, state=None)["accepted"]
    locked(client, [])


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


@pytest.mark.arm("mixed")
def test_single_actuators_bring_the_arm_into_a_state_without_a_name_and_out_of_it(
    client: Observer, boards: Simulation, arm: Arm
) -> None:
    home = format_configuration(arm.manipulator, np.zeros(len(arm.manipulator.modules), dtype=np.int64))

    def done(key: str, **payload: Any) -> None:
        answer = client.send(key, **payload)
        assert answer["accepted"], answer
        assert client.result(answer["id"])["status"] == "succeeded"

    done("goal", waypoints=[{"configuration": home}], id="home")
    unused = dict.fromkeys(("1.1", "1.2", "1.3"), "extended")  # the eighth code of a motor of five positions
    done("jog", actuators=unused)
    assert boards.positions()[:3].tolist() == [1, 1, 1]
    eventually(lambda: "unknown-state" in client.codes)
    assert (client.state["configuration"], client.state["tip"]) == (None, None)
    refused = client.goal((0.0, 0.0, 0.9), id="a")
    assert (refused["accepted"], "is no configuration" in refused["message"]) == (False, True)
    done("jog", actuators=dict.fromkeys(unused, "contracted"))
    eventually(lambda: not client.codes)
    assert client.wait_now("ready")["configuration"] == home
    for payload in ({}, {"actuators": {}}, {"actuators": {"9.1": "extended"}}, {"actuators": {"1.1": 1}}):
        assert client.client.request("jog", payload)["accepted"] is False
