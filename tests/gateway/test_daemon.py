"""The whole chain: `run` in a process of its own, with an executor that simulates the boards, and clients."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.planning.ledger_file import read
from tests.waiting import PATIENCE, eventually

RUN = """
import sys
import typer
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.operate.run import run

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
app.command()(run)
try:
    app()
except CommandFailed as error:
    sys.exit(f"failed: {error}")
"""
EXECUTOR = "from hyperbit.controller.cli import main; main()"
HOUR = 3600.0
FIRST, SECOND = "4646676700771206", "0000000000000001"


class Process:
    def __init__(self, arm: Path, endpoint: str, folder: Path, ledger: Path, *words: str) -> None:
        self.endpoint, self.ledger, self.folder = endpoint, ledger, folder
        environment = {
            **os.environ, "XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder), "NOTIFY_SOCKET": "",
            "OPENBLAS_NUM_THREADS": "1",
        }  # fmt: skip
        environment.pop("STATE_DIRECTORY", None)
        environment.pop("RUNTIME_DIRECTORY", None)
        command = [sys.executable, "-c", RUN, str(arm), "--listen", endpoint, "--ledger", str(ledger), *words]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        )

    @property
    def executors(self) -> list[int]:
        """Ids of its child processes, but the keeper of its events."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        others = (int(number) for number in children.read_text().split())
        return [pid for pid in others if b"keeper.py" not in Path(f"/proc/{pid}/cmdline").read_bytes()]

    def failure(self) -> str:
        """Its output when it ends by itself."""
        assert self.process.stderr
        _, errors = self.process.communicate(timeout=2 * PATIENCE)
        assert self.process.returncode == 1, errors
        return str(errors)


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder of a short name, for sockets."""
    with tempfile.TemporaryDirectory(prefix="hb") as name:
        yield Path(name)


@pytest.fixture
def process(arm_file: Path, endpoint: str, folder: Path) -> Iterator[Process]:
    process = Process(arm_file, endpoint, folder, folder / "ledger.sqlite", "--simulate")
    yield process
    process.process.kill()
    process.process.communicate()


@contextlib.contextmanager
def connected(process: Process) -> Iterator[tuple[Client, list[dict[str, Any]], list[dict[str, Any]]]]:
    """A client of a daemon that is ready, the received states, and the results."""

    def opened() -> zenoh.Session | None:
        assert process.process.poll() is None, process.failure()
        try:
            return zenoh.open(session.configuration("client", connect=process.endpoint))
        except zenoh.ZError:
            return None

    with eventually(opened) as live:
        client, states, results = Client(live, "planar16"), list[dict[str, Any]](), list[dict[str, Any]]()
        client.subscribe("state", states.append)
        client.subscribe("result", results.append)
        eventually(lambda: states and states[-1]["mode"] == "ready")
        yield client, states, results


def gone(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] == "Z"


def test_goals_configurations_and_jogs_move_the_arm_and_a_signal_ends_all_in_order(process: Process) -> None:
    with connected(process) as (client, states, results):
        feedback: list[dict[str, Any]] = []
        goal = {"waypoints": [{"position": [0.55, 2.9]}, {"t": 1.0, "configuration": FIRST}]}
        result = client.run(goal, feedback.append, silence=PATIENCE)
        assert (result["status"], result["configuration"]) == ("succeeded", FIRST)
        assert [message["waypoint"] for message in feedback[1:]] == [0, 1]
        before = states[-1]["measured"][0]
        assert client.request("jog", {"actuators": {"1.left": ["extended", "contracted"][before]}})["accepted"]
        eventually(lambda: states[-1]["measured"][0] == 1 - before)
        plan = client.request("plan", {"waypoints": [{"configuration": SECOND}]}, timeout=PATIENCE)
        assert plan["waypoints"][0]["configuration"] == SECOND
        later = {"id": "later", "waypoints": [{"configuration": FIRST}, {"t": HOUR, "configuration": SECOND}]}
        assert client.request("goal", later, timeout=PATIENCE)["accepted"]
        assert client.request("goal", later, timeout=PATIENCE)["id"] == "later"
        eventually(lambda: states[-1]["goal"] == "later")
        switches = result["switches"] + 1  # the executor sends its counts once a second
        eventually(lambda: sum(read(process.ledger)[0].values()) >= switches)
        (executor,) = process.executors
        process.process.send_signal(signal.SIGTERM)
        assert process.process.wait(PATIENCE) == 0
        eventually(lambda: [r["status"] for r in results if r["id"] == "later"] == ["aborted"])
    assert gone(executor)
    goals = read(process.ledger)[1]
    ended = [(goal["id"], goal["status"]) for goal in goals if not goal["id"].startswith("jog")]
    assert ended == [("later", "aborted"), (result["id"], "succeeded")]


def test_the_planner_ends_with_its_executor_and_says_so(process: Process) -> None:
    with connected(process) as (client, states, results):
        goal = {"id": "a", "waypoints": [{"configuration": FIRST}, {"t": HOUR, "configuration": SECOND}]}
        assert client.request("goal", goal, timeout=PATIENCE)["accepted"]
        eventually(lambda: states[-1]["goal"] == "a")
        os.kill(process.executors[0], signal.SIGKILL)
        assert "failed: the executor ended with code -9" in process.failure()
        eventually(lambda: [result["status"] for result in results] == ["aborted"])
        eventually(lambda: not client.alive())


def test_a_second_daemon_on_the_same_ledger_or_executor_does_not_start(
    process: Process, arm_file: Path, folder: Path
) -> None:
    with connected(process) as (client, _, _):
        pid = process.process.pid
        second = Process(arm_file, "tcp/127.0.0.1:0", folder, process.ledger, "--socket", str(folder))
        assert f"{process.ledger} is in use by process {pid}" in second.failure()
        third = Process(arm_file, "tcp/127.0.0.1:0", folder, folder / "other.sqlite", "--simulate")
        assert "the executor ended with code" in third.failure()
        assert client.request("arm", timeout=PATIENCE)["daemon"]["pid"] == pid


def test_an_executor_that_runs_already_survives_the_planner(arm_file: Path, endpoint: str, folder: Path) -> None:
    socket = folder / "planar16.sock"
    words = ["execute", str(arm_file), "--simulate", "--socket", str(socket), "--journal", str(folder / "journal")]
    command = [sys.executable, "-c", f"import sys; sys.argv[1:] = {words!r}; {EXECUTOR}"]
    executor = subprocess.Popen(command, stdin=subprocess.PIPE)
    try:
        process = Process(arm_file, endpoint, folder, folder / "ledger.sqlite", "--socket", str(folder), "--simulate")
        try:
            with connected(process) as (client, _, _):
                assert process.executors == []
                process.process.send_signal(signal.SIGINT)
                assert process.process.wait(PATIENCE) == 0
                with pytest.raises(Unanswered):
                    client.request("stop", timeout=1.0)
        finally:
            process.process.kill()
            process.process.communicate()
        assert executor.poll() is None
    finally:
        executor.terminate()
        assert executor.wait(PATIENCE) == 0
