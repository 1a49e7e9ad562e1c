"""Goals from a client to the actuators and back."""

import time

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
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
    assert (state["goal"], client.faults(state)) == (None, [])
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
