"""Commands that send a request to a running daemon: cancel, stop, reset, degrade, obstacles."""

from __future__ import annotations

import json
import re

import pytest

from hyperbit.controller.commands.common import CommandFailed, refusal
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from tests.waiting import eventually


def test_a_stop_holds_until_reset(hyperbit, endpoint):
    words = ("planar16", "--connect", endpoint)
    assert hyperbit("stop", *words) == (0, "stopped; the arm holds until reset\n", "")
    code, out, err = hyperbit("send", *words, "--to", "3.0,0.7")
    assert (code, out) == (1, "")
    assert "the arm is stopped" in err
    code, out, err = hyperbit("reset", *words, "--json")
    assert (code, json.loads(out)["accepted"], err) == (0, True, "")
    with connected("planar16", endpoint, None) as client:
        demo.wait_until_ready(client)


def test_cancel_reports_a_missing_goal(hyperbit, endpoint):
    assert hyperbit("cancel", "planar16", "--connect", endpoint) == (
        0,
        "there was no goal to cancel; the arm holds\n",
        "",
    )


def test_an_unknown_arm_is_refused_at_once_with_the_names_of_the_others(endpoint):
    words = r"no daemon for arm 'planer16' at .*\n.*: planar16"
    with pytest.raises(CommandFailed, match=words), connected("planer16", endpoint, None):
        pytest.fail("the context was entered")


@pytest.mark.parametrize("command", ["cancel", "stop", "reset"])
def test_a_command_without_a_daemon_fails_with_a_message(hyperbit, endpoint, command):
    code, out, err = hyperbit(command, "other", "--connect", endpoint)
    assert (code, out) == (1, "")
    assert "'other'" in err


def test_lock_locks_and_unlocks_actuators(hyperbit, endpoint):
    words = ("lock", "planar16", "--connect", endpoint)
    assert hyperbit(*words, "5.left=contracted", "7.right=contracted") == (
        0,
        "locked: 5.left (contracted)\nlocked: 5.left (contracted), 7.right (contracted)\n",
        "",
    )
    code, out, err = hyperbit(*words, "5.left=free", "7.right=free", "--json")
    assert (code, err) == (0, "")
    assert [json.loads(line)["message"] for line in out.splitlines()] == [
        "locked: 7.right (contracted)",
        "no actuator is locked",
    ]


def test_a_refused_change_ends_with_1_and_earlier_changes_remain(hyperbit, endpoint):
    words = ("lock", "planar16", "--connect", endpoint)
    code, out, err = hyperbit(*words, "5.left=contracted", "5.middle=contracted", "7.right=contracted")
    assert (code, out) == (1, "locked: 5.left (contracted)\n")
    known = "module 5 has 5.left, 5.diagonal, 5.right"
    assert err == f"refused (code -1): actuator: '5.middle' is no actuator of this arm; {known}\n"
    code, out, err = hyperbit(*words, "7.right=extended", "--json")
    assert (code, json.loads(out)["accepted"]) == (1, False)
    told, step, end = err.split("\n")
    assert told == "refused (code -1): state: the end-stop of 7.right reads contracted"
    assert (step, end) == ("Next: lock it in this state, or repair the end-stop", "")
    assert hyperbit(*words, "5.left=free")[1] == "no actuator is locked\n"


def test_jog_waits_for_its_result(hyperbit, endpoint):
    code, out, err = hyperbit("jog", "planar16", "5.left=extended", "--connect", endpoint)
    answer, result = out.splitlines()
    assert (code, err, answer) == (0, "", "accepted, 1 switch: 5.left extended")
    assert result.startswith("switched, 1 switch: 5.left in ")
    code, out, _ = hyperbit("jog", "planar16", "5.left=contracted", "--connect", endpoint, "--json")
    answer, result = [json.loads(line) for line in out.splitlines()]
    assert (code, answer["accepted"], result["status"]) == (0, True, "succeeded")


@pytest.mark.parametrize("change", ["5.left", "5.left=", "5.left=1", "5.left=up", "5.left contracted", "5.\udcff=free"])
def test_a_malformed_change_is_unusable_input(hyperbit, change):
    code, out, err = hyperbit("lock", "planar16", "5.left=free", change)
    assert (code, out) == (2, "")
    assert "an actuator, =, and one of contracted, extended, free are needed, as in 5.left=contracted" in err


def test_lock_needs_a_change(hyperbit):
    assert hyperbit("lock", "planar16")[0] == 2


def test_obstacles_block_goals_until_they_are_removed(hyperbit, endpoint, tmp_path):
    file = tmp_path / "regions.yaml"
    file.write_text("regions:\n- {disc: {centre: [0.55, 2.9], radius: 0.2}, name: crate}\n")
    words = ("obstacles", "planar16", "--connect", endpoint)
    goal = {"waypoints": [{"position": [0.55, 2.9]}]}
    with connected("planar16", endpoint, None) as client:
        assert hyperbit(*words, str(file)) == (0, "1 obstacle, 1 of them sent\n", "")
        demo.wait_until_ready(client)
        message = client.request("plan", goal, timeout=60)["message"]
        assert re.search(r"\(0\.55, 2\.9\) (is|seems) out of reach", message)
        code, out, _ = hyperbit(*words, "--none", "--json")
        assert (code, json.loads(out)["message"]) == (0, "0 obstacles, 0 of them sent")
        eventually(lambda: client.request("plan", goal, timeout=60)["accepted"])  # a search of a busy machine may fail


def test_a_fault_in_the_regions_is_refused_by_field(hyperbit, endpoint, tmp_path):
    file = tmp_path / "regions.yaml"
    file.write_text("regions:\n- {disc: {centre: [0.55, 2.9], radius: -1}}\n")
    code, out, err = hyperbit("obstacles", "planar16", str(file), "--connect", endpoint)
    assert (code, out) == (1, "")
    assert err.startswith("refused (code -1): regions[0].disc.radius: ")


def test_obstacles_without_a_file_are_listed(hyperbit, endpoint, tmp_path):
    words = ("obstacles", "planar16", "--connect", endpoint)
    assert hyperbit(*words) == (0, "no obstacles\n", "")
    file = tmp_path / "regions.yaml"
    file.write_text("regions:\n- {disc: {centre: [0.55, 2.9], radius: 0.2}, name: crate}\n")
    assert hyperbit(*words, str(file))[0] == 0
    assert hyperbit(*words) == (0, "disc 'crate': centre [0.55, 2.9], radius 0.2 (sent)\n", "")
    assert [entry["name"] for entry in json.loads(hyperbit(*words, "--json")[1])["sent_obstacles"]] == ["crate"]
    assert hyperbit(*words, "--none")[0] == 0


@pytest.mark.parametrize("words", [("no-such-file.yaml",), ("regions.yaml", "--none")])
def test_unusable_arguments_of_obstacles_end_with_2(hyperbit, words):
    code, out, err = hyperbit("obstacles", "planar16", *words)
    assert (code, out) == (2, "")
    assert err


def test_a_file_without_regions_is_unusable_input(hyperbit, tmp_path):
    file = tmp_path / "regions.yaml"
    file.write_text("- {disc: {centre: [1, 2], radius: 1}}\n")
    code, _, err = hyperbit("obstacles", "planar16", str(file))
    assert code == 2
    assert "no regions: a mapping with `regions` is needed" in err


@pytest.mark.parametrize("words", [("lock", "planar16", "5.left=free"), ("obstacles", "planar16", "--none")])
def test_a_missing_daemon_fails_with_a_message(hyperbit, words):
    code, _, err = hyperbit(*words, "--connect", "tcp/127.0.0.1:1")
    assert code == 1
    assert "nobody listens at tcp/127.0.0.1:1" in err
    assert "Next: start it by: hyperbit run ARM.yaml" in err


def test_a_wrong_name_leads_to_the_arms_that_are_there(hyperbit, endpoint):
    code, _, err = hyperbit("cancel", "nobody", "--connect", endpoint)
    assert code == 1
    assert "no daemon for arm 'nobody' answered" in err
    assert err.rstrip().endswith("Next: name an arm that is there: planar16")


@pytest.mark.parametrize(
    ("reason", "step"),
    [
        ({"reason": "arm-stopped"}, "\nNext: leave the stop by: hyperbit reset left"),
        ({"reason": "arm-in-fault"}, "\nNext: remove the cause, then: hyperbit reset left"),
        ({"reason": "invalid-fields"}, ""),
        ({"reason": "unknown to this client"}, ""),
        ({}, ""),  # of an older daemon, or a result that is no refusal
    ],
)
def test_a_refusal_leads_to_the_next_step(reason, step):
    failed = refusal({"accepted": False, "code": -1, "message": "the arm is stopped", **reason}, "left")
    assert str(failed) == f"refused (code -1): the arm is stopped{step}"


def test_a_halt_without_an_executor_leads_to_its_socket(hyperbit, tmp_path):
    code, _, err = hyperbit("halt", "--socket", str(tmp_path))
    assert code == 1
    assert "Next: name the executor's socket" in err


def test_a_goal_right_after_a_lock_is_planned_around_it(hyperbit, endpoint):
    words = ("planar16", "--connect", endpoint)
    assert hyperbit("lock", *words, "5.left=contracted")[0] == 0
    code, out, err = hyperbit("send", *words, "--to", "0.4,2.8")
    assert (code, err, "reached (0." in out) == (0, "", True)
    assert hyperbit("lock", *words, "5.left=free", "--no-wait") == (0, "no actuator is locked\n", "")
    with connected("planar16", endpoint, None) as client:
        demo.wait_until_ready(client)


@pytest.mark.parametrize("command", ["stop", "reset", "cancel"])
@pytest.mark.parametrize("name", ["*", "a/b", "**"])
def test_what_is_no_name_of_an_arm_is_refused(hyperbit, command, name):
    code, out, err = hyperbit(command, name)
    assert (code, out) == (2, "")
    assert f"'{name}': no name of an arm: 1 to 64 letters, digits, _ and - are needed" in err
