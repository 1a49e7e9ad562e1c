"""An arm of other modules: its tip, single actuators, and states that are no configuration."""

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.notation import format_configuration
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.waiting import eventually

pytestmark = [pytest.mark.arm("mixed"), pytest.mark.buses("virtual")]

UNUSED = {"1.1": "extended", "1.2": "extended", "1.3": "extended"}  # the eighth code of a motor of five positions


def test_goals_in_space_are_reached_by_the_boards(client: Observer, boards: Simulation, arm: Arm) -> None:
    m = arm.manipulator
    drawn = np.random.default_rng(5).integers(0, m.states, (3, len(m.states)))
    for k, goal in enumerate(m.tips(drawn)[:, :3, 3]):
        result = client.move(tuple(goal.tolist()), goal=f"goal {k}")
        tip = m.tip(m.configuration(boards.positions().astype(np.uint8)))
        assert np.linalg.norm(tip[:3, 3] - goal) <= arm.tolerance
        assert result["position"] == pytest.approx(tip[:3, 3])
    assert client.ask("arm")["frames"] == [module.frames.tolist() for module in m.modules]


def test_single_actuators_bring_the_arm_into_a_state_without_a_name_and_out_of_it(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    home = format_configuration(arm.manipulator, np.zeros(len(arm.manipulator.modules), dtype=np.int64))
    answer = client.send("goal", waypoints=[{"configuration": home}], id="home")
    assert answer["accepted"], answer
    assert client.result("home")["status"] == "succeeded"
    answer = client.send("jog", actuators=UNUSED)
    assert answer["accepted"], answer
    assert client.result(answer["id"])["status"] == "succeeded"
    assert boards.positions()[:3].tolist() == [1, 1, 1]
    eventually(lambda: "unknown-state" in client.codes)
    assert (client.state["configuration"], client.state["tip"]) == (None, None)
    refused = client.goal((0.0, 0.0, 0.9), id="a")
    assert (refused["accepted"], "is no configuration" in refused["message"]) == (False, True)
    answer = client.send("jog", actuators={"1.1": "contracted", "1.2": "contracted", "1.3": "contracted"})
    assert client.result(answer["id"])["status"] == "succeeded"
    eventually(lambda: not client.codes)
    assert client.wait_now("ready")["configuration"] == home
    for payload in ({}, {"actuators": {}}, {"actuators": {"9.1": "extended"}}, {"actuators": {"1.1": 1}}):
        assert client.client.request("jog", payload)["accepted"] is False
