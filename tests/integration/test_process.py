"""The installed command as a process of its own, and its ends by signals."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from controller.daemon.ledger import read
from tests.daemon.waiting import PATIENCE, eventually
from tests.integration.conftest import Bench
from tests.integration.harness import Observer
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT

pytestmark = pytest.mark.buses("virtual")  # the embedded boards' own; the installed service is tried on the kernel's


@pytest.fixture
def process(arm_file: Path, endpoint: str, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The installed command with simulated boards, as an operator runs it."""
    command = [str(Path(sys.executable).with_name("hyperbit")), "run", str(arm_file), "--simulate"]
    command += ["--listen", endpoint, "--ledger", str(tmp_path / "ledger.sqlite")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "NOTIFY_SOCKET": ""})
    yield process
    process.kill()
    process.communicate()


def connected(bench: Bench, process: subprocess.Popen[str]) -> Observer:
    """A client of the daemon in that process, once it listens."""

    def connect() -> Observer | None:
        assert process.poll() is None, process.stderr and process.stderr.read()
        try:
            return bench.observer()
        except zenoh.ZError:
            return None

    client = eventually(connect, 2 * PATIENCE)
    client.wait_for("ready")
    return client


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_process_in_order(
    process: subprocess.Popen[str], bench: Bench, tmp_path: Path, number: signal.Signals
) -> None:
    client = connected(bench, process)
    client.move(MIDDLE, goal="a")
    client.goal(RIGHT, LEFT, times=[HOUR, 2 * HOUR], id="b")
    client.wait_for("executing", "goal b")
    process.send_signal(number)
    assert process.wait(PATIENCE) == 0
    result = client.result("b")
    assert (result["status"], result["message"]) == ("aborted", "the daemon is shutting down; the arm holds")
    switches, goals = read(tmp_path / "ledger.sqlite")
    assert [(goal["id"], goal["status"]) for goal in goals] == [("b", "aborted"), ("a", "succeeded")]
    assert sum(switches.values()) == client.result("a")["switches"]


def test_a_killed_process_is_noticed(process: subprocess.Popen[str], bench: Bench) -> None:
    client = connected(bench, process)
    assert client.client.alive()
    watching = bench.session()
    client.goal(MIDDLE, LEFT, times=[0, HOUR], id="a")
    process.kill()
    process.wait(PATIENCE)
    name = "hyperbit/planar16/alive"
    eventually(lambda: not any(reply.ok for reply in watching.liveliness().get(name, timeout=1.0)))
    assert client.results("a") == []
