"""The commands list and watch, and the arm's name, with a daemon in its own process and simulated boards."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

from controller.commands.connection import connected
from controller.commands.operate import demo


def test_list_names_the_arms_that_have_a_daemon(hyperbit, endpoint):
    code, out, err = hyperbit("list", "--connect", endpoint)
    assert (code, err) == (0, "")
    assert out.startswith("planar16 (simulated): ready, ")
    code, out, _ = hyperbit("list", "--connect", endpoint, "--json")
    assert code == 0
    told = json.loads(out)
    assert (told["name"], told["mode"], told["simulated"], told["faults"]) == ("planar16", "ready", True, [])


def test_list_without_a_daemon_fails_with_a_message(hyperbit):
    code, out, err = hyperbit("list", "--connect", "tcp/127.0.0.1:1")
    assert (code, out) == (1, "")
    assert "no daemon at tcp/127.0.0.1:1" in err


def test_watch_prints_changes_as_lines_in_a_pipe(hyperbit, endpoint):
    command = [sys.executable, "-m", "controller.cli", "watch", "planar16", "--connect", endpoint]
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
