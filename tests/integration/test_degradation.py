"""Going on without an actuator that is stuck: found so by its end-stop, or told over Zenoh."""

import dataclasses

import numpy as np
import pytest
from msgspec.structs import replace

from controller.config import Arm
from controller.motion import codes
from drivers.simulation.simulation import Simulation
from tests.integration.conftest import Bench
from tests.integration.harness import Observer
from tests.integration.test_faults import first_to_switch
from tests.integration.test_goals import LEFT, MIDDLE, RIGHT, tip

NEAR = (0.3, 2.8)


@pytest.fixture
def client(bench: Bench, boards: Simulation, arm: Arm) -> Observer:
    """A client of a daemon that goes on without what is stuck, and is ready."""
    bench.arm = dataclasses.replace(arm, settings=replace(arm.settings, on_stuck="continue"))
    bench.run()
    observer = bench.observer()
    observer.wait_for("ready")
    return observer


def test_goals_go_on_without_a_stuck_actuator_and_with_it_when_it_is_repaired(
    client: Observer, boards: Simulation, arm: Arm
) -> None:
    client.move(MIDDLE)
    label, state_now = first_to_switch(client, arm, RIGHT)
    k = arm.manipulator.actuators.index(label)
    boards.fault("stick", label, state_now)
    client.goal(RIGHT, id="a")
    assert (client.result("a")["status"], label in client.result("a")["message"]) == ("aborted", True)
    before = len(client.heard["state"])
    state = client.wait_for("ready", after=before)
    words = f"held: {label} ({'extended' if state_now else 'contracted'})"
    assert client.wait_for("starting", "planning is made ready", after=before)["reason"].endswith(words)
    assert state["degraded"] == [{"actuator": label, "state": state_now}]
    assert [(fault["code"], fault["source"]) for fault in state["faults"]] == [("degraded", label)]
    assert state["commanded"] == state["measured"] == boards.positions().astype(int).tolist()
    refused = client.goal(RIGHT)
    assert (refused["code"], "out of reach" in refused["message"]) == (codes.GOAL_TOLERANCE_VIOLATED, True)
    for number, goal in enumerate((LEFT, MIDDLE, NEAR, LEFT)):
        client.move(goal, goal=f"b{number}")
        assert np.linalg.norm(tip(boards, arm) - goal) <= arm.tolerance
        state = client.wait_now("ready")
        assert state["commanded"][k] == state["measured"][k] == state_now

    boards.fault("release", label)
    assert client.ask("degrade", actuator=label, state=None)["accepted"]
    state = client.wait_now("ready")
    assert (state["degraded"], state["faults"]) == ([], [])
    client.move(RIGHT, goal="c")


def test_an_actuator_that_an_operator_degrades_is_left_as_it_is_and_nothing_moves_by_that(
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
    assert client.wait_now("ready")["degraded"] == [{"actuator": label, "state": state_now}]
    assert boards.switches().tolist() == before
    client.move(LEFT, NEAR, goal="b")
    assert boards.switches()[k] == before[k]
