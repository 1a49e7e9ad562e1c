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
    assert state["measured"] == state["commanded"] == [0] * len(arm.manipulator.actuators)
    assert state["configuration"] == "0" * 16
    assert state["tip"]["position"] == pytest.approx(arm.manipulator.tip([0] * 16)[:2, 3].tolist())
    assert (state["goal"], state["faults"]) == (None, [])
    assert not system.boards.switches().any()


def test_from_goal_to_the_tip(client: Observer, boards: Simulation, arm: Arm) -> None:
    client.move(LEFT)
    before = boards.switches().sum()
    answer = client.goal(MIDDLE, RIGHT, times=[0.0, 1.0], id="a")
    assert (answer["accepted"], answer["code"]) == (True, codes.SUCCESSFUL), answer
    result = client.result("a")
    assert (result["status"], result["code"]) == ("succeeded", codes.SUCCESSFUL)
    assert np.linalg.norm(tip(boards, arm) - RIGHT) <= arm.tolerance
    assert result["position"] == pytest.approx(tip(boards, arm).tolist())
    assert result["switches"] == boards.switches().sum() - before
    feedback = client.last_feedback("a", 1)  # a busy machine may leave out the first
    assert (feedback[-1]["waypoint"], feedback[-1]["switches"]) == (1, result["switches"])
    assert all(f["error"] <= arm.tolerance for f in feedback)
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
    reached = angle(manipulator.tip(manipulator.configuration(boards.positions().astype(np.uint8))))
    assert result["orientation"] == pytest.approx(reached)
    assert result["orientation_error"] == pytest.approx(abs(reached - angle(wanted)))
    assert (result["orientation_error"] <= 0.03, result["error"] <= 0.005) == (True, True)
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


def test_a_new_goal_replaces_the_running_one_and_cancel_holds(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    client.goal(RIGHT, LEFT, times=[0, HOUR], id="a")
    eventually(lambda: client.feedback("a"))
    assert client.goal(MIDDLE, RIGHT, times=[0, HOUR], id="b")["accepted"]
    result = client.result("a")
    assert (result["status"], result["message"]) == ("replaced", "replaced by goal b")
    eventually(lambda: client.feedback("b"))
    motions.clear()
    assert "canceled" in client.ask("cancel")["message"]
    assert client.result("b")["status"] == "canceled"
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
    answer = client.ask("plan", waypoints=[{"t": 1.0, "position": MIDDLE}, {"t": 2.0, "position": RIGHT}])
    assert answer["accepted"], answer
    points = answer["waypoints"]
    assert [(point["t"], len(point["configuration"])) for point in points] == [(1.0, 16), (2.0, 16)]
    assert all(point["error"] <= arm.tolerance for point in points)
    assert answer["switches"] == sum(point["switches"] for point in points) > 0
    refused = client.ask("plan", waypoints=[{"position": [9, 9]}])
    assert (refused["accepted"], refused["code"]) == (False, codes.GOAL_TOLERANCE_VIOLATED)
    client.wait_now("ready")
    eventually(lambda: motions.still() and motions.identifiers)  # it hears heartbeats, and no SYNC
    assert motions.still()


INRUSH = 2


@pytest.mark.arm(inrush=INRUSH)
def test_with_an_inrush_bound_never_more_switch_at_once_and_stages_are_told_as_they_are_on_the_bus(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    """Takes 7 s, as its goals have waypoints at 2 s and 4 s."""
    client.move(LEFT)
    for goal, place in (("a", MIDDLE), ("b", RIGHT)):
        before = boards.switches().sum()
        assert client.goal(place, LEFT, times=[0.0, HOUR], id=goal)["accepted"]
        eventually(lambda before=before: boards.switches().sum() > before)
    assert client.goal(MIDDLE, id="c")["accepted"]
    assert [client.result(name)["status"] for name in "abc"] == ["replaced", "replaced", "succeeded"]
    assert client.wait_now("ready")["goal"] is None
    motions.clear()
    rows, times = [motions.outputs], [2.0, 4.0, 6.0]
    points = [{"t": t * SLOWNESS, "position": place} for t, place in zip(times, (RIGHT, LEFT, MIDDLE), strict=True)]
    for waypoint in client.ask("plan", waypoints=points)["waypoints"]:
        assert sum(map(len, waypoint["stages"])) == waypoint["switches"]
        assert max(map(len, waypoint["stages"])) <= INRUSH
    client.move(RIGHT, LEFT, MIDDLE, goal="d", times=times)
    assert np.linalg.norm(tip(boards, arm) - MIDDLE) <= arm.tolerance
    motions.read()
    counts = np.abs(np.diff(np.array(rows + motions.rows, dtype=int), axis=0)).sum(axis=1)
    assert (counts.max() <= INRUSH, len(counts) > 5) == (True, True)
    feedback = client.last_feedback("d", 2)
    assert len(feedback) == 3
    assert sum(it["stages"] for it in feedback) == len(counts)
    assert all(it["excursion"] is None or it["excursion"] >= 0 for it in feedback)
    answer = client.goal(LEFT, RIGHT, times=[0.0, 0.07], id="e")
    assert (answer["accepted"], answer["code"]) == (False, codes.INVALID_GOAL)
    assert answer["message"].startswith(f"waypoints[0] to waypoints[1]: {0.07 * SLOWNESS:g} s, ")
    assert "switches, at most 2 at once, need" in answer["message"]
    described = client.ask("arm")
    assert (described["inrush"], described["rest_time"]) == (INRUSH, 0.0)
