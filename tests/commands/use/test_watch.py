"""The commands fleet and watch, and the arm's name, with a daemon in its own process and simulated boards."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import pytest
from rich.console import Console

from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from hyperbit.controller.commands.use.fleet import line_of_arm
from hyperbit.controller.commands.use.watch import View, line_of, progress_of
from hyperbit.controller.network.fleet import ArmAddress, ArmStatus
from tests.endpoints import free_endpoint

INTERLOCK = {"code": "interlock", "message": "interlock gate is open"}
STUCK = {"code": "stuck", "message": "actuator 2.1 did not move"}
STATE = {
    "stamp": 0.0, "mode": "fault", "reason": INTERLOCK["message"], "simulated": False, "faults": [STUCK, INTERLOCK],
    "tip": None, "configuration": None, "goal": None, "waypoint": None, "commanded": None, "measured": [0, 1, None, 1],
}  # fmt: skip
# Three arms that publish thousands of states a second, until their standard input ends.
ARMS = """
import sys, threading, time, zenoh
from hyperbit.controller.network import session
state = b'{"mode": "fault", "reason": "a test", "faults": []}'
with zenoh.open(session.configuration("peer", listen=sys.argv[1])) as opened:
    publishers = [opened.declare_publisher(f"hyperbit/a{k}/state") for k in range(3)]
    tokens = [opened.liveliness().declare_token(f"hyperbit/a{k}/alive") for k in range(3)]
    reader = threading.Thread(target=sys.stdin.read)
    reader.start()
    while reader.is_alive():
        for publisher in publishers:
            publisher.put(state)
        time.sleep(0.0001)
"""
LISTS = """
import sys, time
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.use.fleet import fleet
listed = 0
while listed < 5:
    try:
        fleet(connect=sys.argv[1])
        listed += 1
    except CommandFailed:
        time.sleep(0.05)  # the arms are being started
"""


def test_fleet_names_the_arms_that_have_a_daemon(hyperbit, endpoint):
    code, out, err = hyperbit("fleet", "--connect", endpoint)
    assert (code, err) == (0, "")
    assert "planar16 (simulated)" in out
    code, out, _ = hyperbit("fleet", "--connect", endpoint, "--json")
    assert code == 0
    told = json.loads(out)
    assert (told["name"], told["mode"], told["simulated"], told["faults"]) == ("planar16", "ready", True, [])


def test_fleet_without_a_daemon_fails_with_a_message(hyperbit):
    code, out, err = hyperbit("fleet", "--connect", "tcp/127.0.0.1:1")
    assert (code, out) == (1, "")
    assert "nobody listens at tcp/127.0.0.1:1" in err


def test_watch_prints_changes_as_lines_in_a_pipe(hyperbit, endpoint):
    command = [sys.executable, "-m", "hyperbit", "watch", "planar16", "--connect", endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=os.environ, text=True) as watching:
        assert watching.stdout is not None
        first = watching.stdout.readline()
        hyperbit("stop", "planar16", "--connect", endpoint)
        second = watching.stdout.readline()
        hyperbit("reset", "planar16", "--connect", endpoint)
        watching.send_signal(signal.SIGINT)
        assert watching.wait(20) == 0
    with connected("planar16", endpoint, None) as client:
        demo.wait_until_ready(client)
    assert " ready (simulated): " in first
    assert " stopped (simulated): " in second
    assert "; tip (" in second


def test_a_fault_that_is_the_reason_of_the_mode_is_printed_once():
    arm = ArmStatus(ArmAddress("", "a"), None, STATE, 0.0, None, None, is_new=False)
    stuck = "stuck: actuator 2.1 did not move"
    assert line_of_arm(arm) == f"a: fault, interlock: interlock gate is open; {stuck}"
    assert line_of(STATE) == f"fault: interlock: interlock gate is open; tip (unknown); {stuck}"
    ready = {**STATE, "mode": "ready", "reason": "holding", "faults": [STUCK]}
    assert line_of(ready) == f"ready: holding; tip (unknown); {stuck}"


def test_the_progress_of_a_goal_is_told():
    progress = {"waypoints": 5, "reached": 2, "begins": 95.0, "ends": 103.2}
    assert progress_of({"stamp": 100.0, "progress": progress}) == "2 of 5 waypoints, 3.2 s left"
    assert progress_of({"stamp": 104.0, "progress": progress}) == "2 of 5 waypoints, 0.8 s late"
    assert progress_of({"stamp": 100.0, "progress": None}) == progress_of(STATE) == ""


@pytest.mark.parametrize(
    ("labels", "shown"), [(["1.1", "1.2", "2.left", "2.right"], "▯▮ ?▮"), ([], "▯▮?▮")], ids=["labels", "none"]
)
def test_watch_separates_the_actuators_of_modules(labels, shown):
    view = View("a", labels)
    view.receive_message("state", STATE)
    console = Console(width=100, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(view)
    assert f"│ {shown} " in console.export_text()


def test_watch_shows_whole_numbers_of_overruns(endpoint, hyperbit):
    with connected("planar16", endpoint, None) as client:
        diagnostics = client.next_message("diagnostics")
    view = View("planar16", [])
    view.receive_message("state", STATE)
    view.receive_message("diagnostics", {**diagnostics, "loop": {**diagnostics["loop"], "overruns": 3.0}})
    console = Console(width=200, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(view)
    assert ", 3 overruns" in console.export_text()


def test_states_that_arrive_at_the_end_of_a_list_cause_no_message():
    endpoint = free_endpoint()
    arms = subprocess.Popen([sys.executable, "-c", ARMS, endpoint], stdin=subprocess.PIPE)
    assert arms.stdin is not None
    with arms, arms.stdin:
        command = [sys.executable, "-c", LISTS, endpoint]
        listed = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (listed.returncode, listed.stderr) == (0, "")
    rows = {" ".join(line.split()) for line in listed.stdout.splitlines()}
    assert rows == {"namespace arm host version mode goal faults", *(f"a{k} fault" for k in range(3))}  # no log
