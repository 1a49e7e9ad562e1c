"""Commands beside a running daemon, which all of these tests share: each leaves it ready."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import pytest

from tests.commands import transcript
from tests.commands.conftest import ARM
from tests.system.stack import daemon
from tests.waiting import PATIENCE

pytestmark = pytest.mark.real_time
TRANSCRIPTS = transcript.read(daemon=True)


@pytest.mark.parametrize("title", TRANSCRIPTS)
def test_commands_print_and_end_as_in_their_transcript(title, folder, hyperbit, endpoint):
    transcript.play(TRANSCRIPTS[title], folder, hyperbit, endpoint)


def test_send_takes_an_angle_and_reports_its_error(hyperbit, endpoint):
    code, out, err = hyperbit("send", "planar16", "--to", "0.55,2.9,0.3", "--connect", endpoint, "--json")
    result = json.loads(out.splitlines()[-1])
    assert (code, err) == (0, "")
    assert result["orientation"] == pytest.approx(0.3, abs=0.05)
    assert result["orientation_error"] == pytest.approx(abs(result["orientation"] - 0.3))


def test_an_interrupt_cancels_the_goal_that_was_sent(endpoint, tmp_path):
    (tmp_path / "goal.csv").write_text("x,y,t\n0.5,2.8,0\n0.5,2.8,300\n")
    words = ["send", "planar16", str(tmp_path / "goal.csv"), "--connect", endpoint]
    with subprocess.Popen(
        [sys.executable, "-m", "hyperbit", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        text=True,
    ) as sending:
        assert sending.stdout is not None
        assert sending.stdout.readline()  # the daemon's answer: the goal is accepted
        sending.send_signal(signal.SIGINT)
        out, err = sending.communicate(timeout=PATIENCE)
    assert (sending.returncode, err.startswith("interrupted: canceling goal ")) == (130, True)
    assert out.endswith(": canceled\n")
    daemon.wait_until_ready(ARM, endpoint)


def test_watch_prints_changes_as_lines_in_a_pipe(hyperbit, endpoint):
    there = ("planar16", "--connect", endpoint)
    command = [sys.executable, "-m", "hyperbit", "watch", *there]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as watching:
        assert watching.stdout is not None
        first = watching.stdout.readline()
        hyperbit("stop", *there)
        second = watching.stdout.readline()
        hyperbit("reset", *there)
        watching.send_signal(signal.SIGINT)
        assert watching.wait(PATIENCE) == 0
    daemon.wait_until_ready(ARM, endpoint)
    assert " ready (simulated): " in first
    assert " stopped (simulated): " in second
    assert "; tip (" in second


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("watch --connect HERE pl", "planar16"),
        ("jog --connect HERE planar16 16.", "16.left= 16.diagonal= 16.right="),
    ],
)
def test_bash_completes_what_the_daemon_has(completed, endpoint, words, found):
    assert completed(words.replace("HERE", endpoint)) == found.split()
