"""Goals from a client to the actuators and back."""

import time

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.frames import angle
from hyperbit.controller.refusals import codes
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT, tip
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually


@pytest.mark.fresh
def test_ready_at_start_with_measured_states(system: System, arm: Arm) -> None:
    system.start()
    with system.client() as client:
        state = client.wait_for("ready")
    count = len(arm.manipulator.actuators)
    assert state["measured"] == state["commanded"] == [0] * count
    assert state["configuration"] == "0" * 16
    assert state["tip"]["position"] == pytest.approx(arm.manipulator.tip([0] * 16)[:2, 3].tolist())
    assert (state["goal"], state["faults"]) == (None, [])
    assert not system.boards.switches().any()


def test_from_goal_to_the_tip(client: Observer, boards: Simulation, arm: Arm) -> None:
    client.move(LEFT)
    before = boards.switches().sum()
    answer = client.goal(MIDDLE, RIGHT, times=[0.0, 1.0], id="a")
    assert answer["accepted"], answer
    assert answer["code"] == codes.SUCCESSFUL
    result = client.result("a")
    assert (result["status"], result["code"]) == ("succeeded", codes.SUCCESSFUL)
    assert np.linalg.norm(tip(boards, arm) - RIGHT) <= arm.tolerance
    assert result["position"] == pytest.approx(tip(boards, arm).tolist())
    assert result["switches"] == boards.switches().sum() - before
    feedback = client.last_feedback("a", 1)  # a busy machine may leave out the first
    assert feedback[-1]["waypoint"] == 1
    assert all(f["error"] <= arm.tolerance for f in feedback)
    assert feedback[-1]["switches"] == result["switches"]
    state = client.wait_now("ready")
    assert state["measured"] == state["commanded"] == boards.positions().astype(int).tolist()


def test_a_pose_is_reached_in_its_orientation(client: Observer, boards: Simulation, arm: Arm) -> None:
    manipulator = arm.manipulator
    wanted = manipulator.tip(np.random.default_rng(1).integers(0, manipulator.states))
    pose = {"position": wanted[:2, 3].tolist(), "orientation": angle(wanted)}
    asked = {"waypoints": [pose], "tolerance": {"position": 0.005, "orientation": 0.03}, "id": "a"}
    assert client.ask("plan", **asked)["waypoints"][0]["orientation_error"] <= 0.03
    assert client.send("goal", **asked)["accepted"]
    result = client.result("a")
    assert (result["status"], result["code"]) == ("succeeded", codes.SUCCESSFUL)
    reached = manipulator.tip(manipulator.configuration(boards.positions().astype(np.uint8)))
    assert result["orientation"] == pytest.approx(angle(reached))
    assert result["orientation_error"] == pytest.approx(abs(angle(reached) - angle(wanted)))
    assert result["orientation_error"] <= 0.03
    assert result["error"] <= 0.005
    refused = client.ask("goal", **{**asked, "id": "b", "path_tolerance": 0.1})
    assert (refused["accepted"], refused["code"]) == (False, codes.INVALID_GOAL)
    assert "lines are followed by position only" in refused["message"]


def test_a_waypoint_that_is_a_configuration(client: Observer, boards: Simulation, arm: Arm) -> None:
    drawn = np.random.default_rng(2).integers(0, arm.manipulator.states)
    digits = "".join(map(str, drawn))
    points = [{"t": 0.0, "position": LEFT}, {"t": 0.5, "configuration": digits}]
    assert client.ask("plan", waypoints=points)["waypoints"][-1]["configuration"] == digits
    assert client.send("goal", waypoints=points, id="a")["accepted"]
    assert client.result("a")["status"] == "succeeded"
    assert client.wait_now("ready")["configuration"] == digits
    assert boards.positions().astype(int).tolist() == arm.manipulator.actuator_states(drawn).tolist()


def test_waypoints_are_not_begun_before_their_times(client: Observer, arm: Arm, motions: Motions) -> None:
    client.move(LEFT)
    motions.clear()
    stamp, times = time.time() + 1.5 * SLOWNESS, [0.0, 0.5, 1.0]
    assert client.goal(MIDDLE, RIGHT, LEFT, times=times, stamp=stamp, id="a")["accepted"]
    assert client.result("a")["status"] == "succeeded"
    motions.read()
    assert 1 <= len(motions.moved_at) <= 3, "a busy machine may leave some out"
    early = arm.settings.travel_time + 0.05 * SLOWNESS
    assert motions.moved_at[0] > stamp - early
    assert motions.moved_at[-1] > stamp + SLOWNESS - early


def test_a_new_goal_replaces_the_running_one(client: Observer, boards: Simulation, arm: Arm) -> None:
    client.goal(MIDDLE, LEFT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    assert client.goal(RIGHT, id="b")["accepted"]
    assert client.result("b")["status"] == "succeeded"
    result = client.result("a")
    assert (result["status"], result["message"]) == ("replaced", "replaced by goal b")
    assert np.linalg.norm(tip(boards, arm) - RIGHT) <= arm.tolerance


def test_cancel_holds(client: Observer, boards: Simulation, arm: Arm, motions: Motions) -> None:
    client.goal(MIDDLE, RIGHT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    motions.clear()
    assert "canceled" in client.ask("cancel")["message"]
    assert client.result("a")["status"] == "canceled"
    client.wait_now("ready", "canceled")
    assert np.linalg.norm(tip(boards, arm) - MIDDLE) <= arm.tolerance
    assert motions.still()


def test_stop_refuse_reset_go(client: Observer, boards: Simulation, motions: Motions) -> None:
    client.goal(MIDDLE, RIGHT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    motions.clear()
    assert client.ask("stop")["accepted"]
    assert "stop" in client.result("a")["message"]
    refused = client.goal(LEFT, id="b")
    assert (refused["accepted"], refused["id"]) == (False, "b")
    assert "the arm is stopped" in refused["message"]
    before = boards.positions().tolist()
    client.reset()
    assert boards.positions().tolist() == before, "reset moved something"
    assert motions.still()
    client.move(LEFT)
    assert client.results("b") == []


def test_a_plan_moves_nothing(client: Observer, arm: Arm, motions: Motions) -> None:
    client.move(LEFT)
    motions.clear()
    points = [{"t": 1.0, "position": MIDDLE}, {"t": 2.0, "position": RIGHT}]
    answer = client.ask("plan", waypoints=points)
    assert answer["accepted"], answer
    assert [w["t"] for w in answer["waypoints"]] == [1.0, 2.0]
    assert [len(w["configuration"]) for w in answer["waypoints"]] == [16, 16]
    assert all(w["error"] <= arm.tolerance for w in answer["waypoints"])
    assert answer["switches"] == sum(w["switches"] for w in answer["waypoints"]) > 0
    refused = client.ask("plan", waypoints=[{"position": [9, 9]}])
    assert (refused["accepted"], refused["code"]) == (False, codes.GOAL_TOLERANCE_VIOLATED)
    client.wait_now("ready")
    eventually(lambda: motions.still() and motions.identifiers)  # it hears heartbeats, and no SYNC
    assert motions.still()
