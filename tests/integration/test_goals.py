"""Goals from a client to the actuators and back."""

import json
import time

import can
import numpy as np
import pytest

from controller.config import Arm
from controller.daemon.ledger import read
from controller.daemon.service import Daemon
from controller.manipulator.frames import angle
from controller.motion import codes
from drivers import cia301
from drivers.simulation.simulation import Simulation
from tests.daemon.waiting import PATIENCE, SLOWNESS, eventually
from tests.integration.conftest import Bench
from tests.integration.harness import Observer

LEFT, MIDDLE, RIGHT = (0.4, 2.9), (0.55, 2.9), (3.0, 0.7)
HOUR = 3600.0


def tip(boards: Simulation, arm: Arm) -> np.ndarray:
    """Where the tip physically is."""
    positions = boards.positions()
    assert np.isin(positions, (0, 1)).all(), "an actuator is between its ends"
    return arm.manipulator.tip(arm.manipulator.configuration(positions))[:2, 3]


def drain(listener: can.BusABC) -> list[can.Message]:
    frames = []
    while (frame := listener.recv(0)) is not None:
        frames.append(frame)
    return frames


def syncs(frames: list[can.Message]) -> list[float]:
    return [frame.timestamp for frame in frames if frame.arbitration_id == cia301.SYNC]


def test_ready_at_start_with_measured_states(client: Observer, arm: Arm) -> None:
    state = client.wait_for("ready")
    count = len(arm.manipulator.actuators)
    assert state["measured"] == state["commanded"] == [0] * count
    assert state["configuration"] == "0" * 16
    assert state["tip"]["position"] == pytest.approx(arm.manipulator.tip([0] * 16)[:2, 3].tolist())
    assert (state["goal"], state["faults"]) == (None, [])


def test_from_goal_to_the_tip(client: Observer, boards: Simulation, arm: Arm) -> None:
    answer = client.goal(MIDDLE, RIGHT, id="a")
    assert answer["accepted"], answer
    assert answer["code"] == codes.SUCCESSFUL
    result = client.result("a")
    assert (result["status"], result["code"]) == ("succeeded", codes.SUCCESSFUL)
    assert np.linalg.norm(tip(boards, arm) - RIGHT) <= arm.tolerance
    assert result["position"] == pytest.approx(tip(boards, arm).tolist())
    assert result["switches"] == boards.switches().sum()
    feedback = eventually(lambda: [f for f in [client.feedback("a")] if len(f) == 2])[0]
    assert [f["waypoint"] for f in feedback] == [0, 1]
    assert all(f["error"] <= arm.tolerance for f in feedback)
    assert feedback[0]["switches"] < feedback[1]["switches"] == result["switches"]
    state = client.wait_now("ready")
    assert state["measured"] == state["commanded"] == boards.positions().astype(int).tolist()


def test_a_pose_is_reached_in_its_orientation(client: Observer, boards: Simulation, arm: Arm) -> None:
    manipulator = arm.manipulator
    wanted = manipulator.tip(np.random.default_rng(1).integers(0, manipulator.states))
    pose = {"position": wanted[:2, 3].tolist(), "orientation": angle(wanted)}
    asked = {"waypoints": [pose], "tolerance": {"position": 0.005, "orientation": 0.03}, "id": "a"}
    planned = client.ask("plan", **asked)
    assert planned["waypoints"][0]["orientation_error"] <= 0.03
    assert client.ask("goal", **asked)["accepted"]
    result = client.result("a")
    assert (result["status"], result["code"]) == ("succeeded", codes.SUCCESSFUL)
    reached = manipulator.tip(manipulator.configuration(boards.positions()))
    assert result["orientation"] == pytest.approx(angle(reached))
    assert result["orientation_error"] == pytest.approx(abs(angle(reached) - angle(wanted)))
    assert result["orientation_error"] <= 0.03
    assert result["error"] <= 0.005
    refused = client.ask("goal", **{**asked, "id": "b", "path_tolerance": 0.1})
    assert (refused["accepted"], refused["code"]) == (False, codes.INVALID_GOAL)
    assert "lines are followed by position only" in refused["message"]


def test_waypoints_are_settled_at_their_times(
    client: Observer, boards: Simulation, arm: Arm, listener: can.BusABC
) -> None:
    stamp = time.time() + 1.5 * SLOWNESS
    times = [0.0, 0.5, 1.0]
    answer = client.goal(MIDDLE, RIGHT, LEFT, times=times, stamp=stamp, id="a")
    assert answer["accepted"], answer
    drain(listener)
    assert client.result("a")["status"] == "succeeded"
    switched = syncs(drain(listener))
    assert len(switched) == 3
    due = [stamp + t * SLOWNESS for t in times]
    for at, settled in zip(switched, due, strict=True):
        assert settled - arm.settings.travel_time - 0.05 * SLOWNESS < at, "switched too early"
        assert at < settled + 0.45 * SLOWNESS, "switched far too late"
    assert any(at < settled for at, settled in zip(switched, due, strict=True)), "none was switched ahead"


def test_a_new_goal_replaces_the_running_one(client: Observer, boards: Simulation, arm: Arm) -> None:
    client.goal(MIDDLE, LEFT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    assert client.goal(RIGHT, id="b")["accepted"]
    assert client.result("b")["status"] == "succeeded"
    result = client.result("a")
    assert (result["status"], result["message"]) == ("replaced", "replaced by goal b")
    assert np.linalg.norm(tip(boards, arm) - RIGHT) <= arm.tolerance


def test_cancel_holds(client: Observer, boards: Simulation, arm: Arm, listener: can.BusABC) -> None:
    client.goal(MIDDLE, RIGHT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    drain(listener)
    assert client.ask("cancel")["message"] == "canceled"
    assert client.result("a")["status"] == "canceled"
    client.wait_now("ready", "canceled")
    assert np.linalg.norm(tip(boards, arm) - MIDDLE) <= arm.tolerance
    assert syncs(drain(listener)) == []


def test_stop_refuse_reset_go(client: Observer, boards: Simulation, listener: can.BusABC) -> None:
    client.goal(MIDDLE, RIGHT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    drain(listener)
    assert client.ask("stop")["accepted"]
    assert client.result("a")["message"] == "emergency stop; the arm holds"
    refused = client.goal(LEFT, id="b")
    assert (refused["accepted"], refused["id"]) == (False, "b")
    assert refused["message"] == "the arm is stopped: emergency stop; the arm holds until reset"
    before = boards.positions().tolist()
    assert client.ask("reset")["accepted"]
    client.wait_now("ready")
    assert boards.positions().tolist() == before, "reset moved something"
    assert syncs(drain(listener)) == []
    client.move(LEFT)
    assert client.results("b") == []


BAD = {
    "no JSON": (b"{", codes.INVALID_GOAL, "not JSON"),
    "no UTF-8": (b"\xff", codes.INVALID_GOAL, "not UTF-8"),
    "nothing": (b"", codes.INVALID_GOAL, "not JSON"),
    "unknown field": ({"waypoints": [], "velocity": 1}, codes.INVALID_GOAL, "velocity: unknown field"),
    "surrogate": (b'{"\\ud800": 1}', codes.INVALID_GOAL, "unknown field"),
    "NaN": (b'{"waypoints": [{"position": [NaN, 1]}]}', codes.INVALID_GOAL, "waypoints[0].position[0]: nan"),
    "empty": ({"waypoints": []}, codes.INVALID_GOAL, "empty"),
    "spatial": ({"waypoints": [{"position": [1, 2, 3]}]}, codes.INVALID_GOAL, "3 coordinates"),
    "out of reach": ({"waypoints": [{"position": [9, 9]}]}, codes.GOAL_TOLERANCE_VIOLATED, "out of reach"),
    "long ago": ({"stamp": 1, "waypoints": [{"position": [1, 2]}]}, codes.OLD_HEADER_TIMESTAMP, "before it arrived"),
    "large": (b" " * 10_000_000, codes.INVALID_GOAL, "10000000 bytes"),
    "deep": (b"[" * 100_000, codes.INVALID_GOAL, "not JSON"),
    "running id": ({"id": "a", "waypoints": [{"position": [0.4, 2.9]}]}, codes.INVALID_GOAL, "running already"),
}


def test_bad_goals_are_refused_and_disturb_nothing(client: Observer, bench: Bench, daemon: Daemon) -> None:
    client.goal(MIDDLE, LEFT, times=[0, HOUR], id="a")
    session, key = bench.session(), f"hyperbit/{bench.arm.settings.name}/goal"
    for name, (payload, code, words) in BAD.items():
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        (reply,) = list(session.get(key, payload=data, timeout=PATIENCE))
        answer = json.loads(reply.ok.payload.to_bytes())
        assert (answer["accepted"], answer["code"]) == (False, code), name
        assert words in answer["message"], name
    assert client.heard["result"] == []
    assert client.wait_now("executing")["goal"] == "a"
    assert client.goal(RIGHT, LEFT, id="b")["accepted"]
    assert client.result("b")["status"] == "succeeded"
    assert client.result("a")["status"] == "replaced"


def test_a_goal_can_be_put(client: Observer, bench: Bench, boards: Simulation, arm: Arm) -> None:
    session, key = bench.session(), f"hyperbit/{arm.settings.name}/goal"
    session.put(key, json.dumps({"id": "a", "waypoints": [{"position": MIDDLE}]}))
    assert client.result("a")["status"] == "succeeded"
    assert np.linalg.norm(tip(boards, arm) - MIDDLE) <= arm.tolerance


def test_a_put_that_is_refused_is_told_on_result(client: Observer, bench: Bench, arm: Arm) -> None:
    session, prefix = bench.session(), f"hyperbit/{arm.settings.name}"
    session.put(f"{prefix}/goal", json.dumps({"id": "a", "waypoints": [{"position": [9, 9]}]}))
    result = client.result("a")
    assert (result["status"], result["code"]) == ("refused", codes.GOAL_TOLERANCE_VIOLATED)
    assert "out of reach" in result["message"]
    session.put(f"{prefix}/goal", b"\xff")
    eventually(lambda: client.results(None))
    session.put(f"{prefix}/stop", b"")
    client.wait_for("stopped")
    session.put(f"{prefix}/goal", json.dumps({"id": "b", "waypoints": [{"position": MIDDLE}]}))
    assert client.result("b")["message"].startswith("the arm is stopped")


def test_a_plan_moves_nothing(client: Observer, boards: Simulation, arm: Arm, listener: can.BusABC) -> None:
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
    assert boards.switches().sum() == 0
    heard = drain(listener)
    assert heard, "the listener must hear heartbeats"
    assert syncs(heard) == []


def test_two_goals_at_once_have_one_outcome_each(client: Observer, bench: Bench, boards: Simulation, arm: Arm) -> None:
    session, key = bench.session(), f"hyperbit/{arm.settings.name}/goal"
    goals = {"a": MIDDLE, "b": RIGHT}
    asked = {
        name: session.get(key, payload=json.dumps({"id": name, "waypoints": [{"position": p}]}), timeout=PATIENCE)
        for name, p in goals.items()
    }
    answers = {name: [json.loads(r.ok.payload.to_bytes()) for r in replies] for name, replies in asked.items()}
    assert [len(a) for a in answers.values()] == [1, 1]
    assert all(a[0]["accepted"] for a in answers.values())
    ends = {name: client.result(name)["status"] for name in goals}
    assert "succeeded" in ends.values()
    assert set(ends.values()) <= {"succeeded", "replaced"}
    client.wait_now("ready")
    assert [len(client.results(name)) for name in goals] == [1, 1]


def test_a_later_client_is_as_good_as_the_first(client: Observer, bench: Bench) -> None:
    other = bench.observer()
    other.wait_for("ready")
    client.move(MIDDLE, goal="a")
    other.move(LEFT, goal="b")
    for observer in (client, other):
        assert observer.result("b")["status"] == "succeeded"
    assert other.result("a") == client.result("a")
    assert client.client.run({"waypoints": [{"position": RIGHT}]})["status"] == "succeeded"


def test_results_and_switches_are_in_the_ledger(client: Observer, bench: Bench, boards: Simulation) -> None:
    client.move(MIDDLE, goal="a")
    client.move(RIGHT, goal="b")
    bench.stack.close()
    switches, goals = read(bench.ledger)
    assert sum(switches.values()) == boards.switches().sum()
    assert [(goal["id"], goal["status"]) for goal in goals] == [("b", "succeeded"), ("a", "succeeded")]
