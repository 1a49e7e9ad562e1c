"""Locked actuators, detected as stuck by their end-stops or locked over Zenoh; the arm continues without them."""

from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.network.client import Message
from hyperbit.controller.refusals import codes
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.arms import QUICK
from tests.system.stack.observer import Observer
from tests.system.stack.places import LEFT, MIDDLE, RIGHT, first_to_switch, tip
from tests.waiting import eventually

NEAR = (0.3, 2.8)

pytestmark = [pytest.mark.arm(on_stuck="continue", boards=QUICK), pytest.mark.buses("virtual")]


def locked(client: Observer, actuators: list[Any]) -> Message:
    """Waits for a state of a ready arm with exactly these locked actuators; returns it."""
    return eventually(lambda: s if (s := client.wait_now("ready"))["degraded"] == actuators else None)


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


def test_an_actuator_that_an_operator_locks_is_left_as_it_is_and_nothing_moves_by_that(
    client: Observer, boards: Simulation, arm: Arm
) -> None:
    client.move(MIDDLE)
    label, state_now = first_to_switch(client, arm, RIGHT)
    k = arm.manipulator.actuators.index(label)
    before = boards.switches().tolist()
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
