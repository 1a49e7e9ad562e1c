"""Arguments of the commands jog, halt and lock, and of --configuration in send and plan."""

from __future__ import annotations

import json

import pytest

from hyperbit.controller.motion.decoding.requests import DegradeMessage
from tests.gateway.conftest import NO_ACTUATOR

NOWHERE = ("--connect", "tcp/127.0.0.1:1")
FIRST, SECOND = "4646676700771206", "4646676700771207"
ARM = "deploy/planar16.yaml"


def test_jog_sends_all_actuators_in_one_request(hyperbit, gateway):
    words = ("jog", "a", "5.left=extended", "7.right=contracted", "--connect", gateway.endpoint)
    assert hyperbit(*words, "--no-wait") == (0, "jog\n", "")
    assert gateway.planner.heard == [("jog", {"5.left": "extended", "7.right": "contracted"})]


@pytest.mark.parametrize("change", ["5.left", "5.left=", "5.left=free", "5.left=1", "5.\udcff=extended"])
def test_a_change_that_jog_does_not_know_is_unusable_input(hyperbit, change):
    code, out, err = hyperbit("jog", "a", "5.right=extended", change, *NOWHERE)
    assert (code, out) == (2, "")
    assert "an actuator, =, and contracted or extended are needed, as in 5.left=extended" in err


def test_an_actuator_is_jogged_to_one_state(hyperbit):
    code, _, err = hyperbit("jog", "a", "5.left=extended", "5.left=contracted", *NOWHERE)
    assert (code, "5.left is given twice" in err) == (2, True)


def test_stop_sends_a_request(hyperbit, gateway):
    assert hyperbit("stop", "a", "--connect", gateway.endpoint) == (0, "stop\n", "")
    assert gateway.planner.heard == [("stop", None)]


def test_a_halt_without_an_executor_fails_with_a_message(hyperbit, tmp_path):
    code, out, err = hyperbit("halt", "a", "--socket", str(tmp_path))
    assert (code, out) == (1, "")
    assert "no executor answers" in err
    assert "hyperbit stop ARM" in err


def test_lock_sends_the_key_degrade(hyperbit, gateway):
    code, _, err = hyperbit("lock", "a", "5.left=contracted", "--connect", gateway.endpoint)
    assert (code, err) == (1, f"refused (code -1): {NO_ACTUATOR}\n")
    assert gateway.planner.heard == [("degrade", DegradeMessage("5.left", 0))]


def test_send_takes_one_kind_of_goal(hyperbit, gateway):
    code, _, err = hyperbit("send", "a", "--configuration", FIRST, "--to", "1,2", "--connect", gateway.endpoint)
    assert (code, "give one of a goal's file, --to, --configuration and --pose" in err) == (2, True)


def test_plan_describes_a_configuration_without_a_search(hyperbit, own_folders):
    words = ("plan", ARM, "--configuration", SECOND, "--previous", FIRST, "--json")
    code, out, err = hyperbit(*words)
    line = json.loads(out)
    assert (code, err) == (0, "")
    assert (line["configuration"], line["switches"], line["within_tolerance"]) == (SECOND, 1, True)
    assert line["goal"] == line["position"]


@pytest.mark.parametrize(("text", "sentence"), [("46", "has 2 modules, the arm has 16"), ("9" * 16, "states 0 to 7")])
def test_plan_refuses_a_configuration_that_the_arm_does_not_have(hyperbit, text, sentence):
    code, _, err = hyperbit("plan", ARM, "--configuration", text)
    assert (code, sentence in err) == (2, True)


def test_plan_takes_one_kind_of_goal(hyperbit):
    code, _, err = hyperbit("plan", ARM, "--configuration", FIRST, "--goal", "1,2")
    assert (code, "give one of --goal, --goals and --configuration" in err) == (2, True)
