"""The whole chain: `run` in a process of its own, with an executor that simulates the boards, and clients."""

import contextlib
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.planning.ledger_file import read
from tests.system.stack.processes import Process, commands
from tests.waiting import PATIENCE, eventually

pytestmark = pytest.mark.real_time
HOUR = 3600.0
FIRST, SECOND = "4646676700771206", "0000000000000001"
Heard = list[dict[str, Any]]


class Place:
    """A folder with the arm's file, and processes of hyperbit in it, which end with the test."""

    def __init__(self, folder: Path, arm: Path, endpoint: str) -> None:
        self.folder, self.ledger, self._arm, self.endpoint = folder, folder / "ledger.sqlite", arm, endpoint
        self.processes: list[Process] = []

    def start(self, *words: str) -> Process:
        folders = {name: str(self.folder) for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME")}
        quiet = {"NOTIFY_SOCKET": "", "OPENBLAS_NUM_THREADS": "1", "STATE_DIRECTORY": "", "RUNTIME_DIRECTORY": ""}
        log = self.folder / f"log-{len(self.processes)}"
        self.processes.append(commands().start([words[0], str(self._arm), *words[1:]], log, folders | quiet))
        return self.processes[-1]

    def run(self, *words: str, ledger: Path | None = None, endpoint: str = "") -> Process:
        named = ("--listen", endpoint or self.endpoint, "--ledger", str(ledger or self.ledger))
        return self.start("run", *named, *words)

    def end(self) -> None:
        for process in reversed(self.processes):
            process.kill()


@pytest.fixture
def place(arm_file: Path, endpoint: str) -> Iterator[Place]:
    with tempfile.TemporaryDirectory(prefix="hb") as name:  # a short name, for sockets
        place = Place(Path(name), arm_file, endpoint)
        yield place
        place.end()


def executors(process: Process) -> list[int]:
    """Returns the ids of its child processes, but the keeper of its events."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    others = (int(number) for number in children.read_text().split())
    return [pid for pid in others if b"keeper.py" not in Path(f"/proc/{pid}/cmdline").read_bytes()]


def failure(process: Process) -> str:
    """Returns what a process has said when it ended by itself."""
    assert process.code == 1
    return " ".join(process.log.read_text().split())


@contextlib.contextmanager
def connected(place: Place) -> Iterator[tuple[Client, Heard, Heard]]:
    """A client of a daemon that is ready, the received states, and the results."""

    def opened() -> zenoh.Session | None:
        assert place.processes[-1].alive, failure(place.processes[-1])
        try:
            return zenoh.open(session.configuration("client", connect=place.endpoint))
        except zenoh.ZError:
            return None

    with eventually(opened) as live:
        client, states, results = Client(live, "planar16"), Heard(), Heard()
        client.subscribe("state", states.append)
        client.subscribe("result", results.append)
        eventually(lambda: states and states[-1]["mode"] == "ready")
        yield client, states, results


def gone(number: int) -> bool:
    path = Path(f"/proc/{number}/stat")
    return not path.exists() or path.read_text().rpartition(")")[2].split()[0] == "Z"


def test_goals_configurations_and_jogs_move_the_arm_and_a_signal_ends_all_in_order(place: Place) -> None:
    process = place.run("--simulate")
    with connected(place) as (client, states, results):
        feedback = Heard()
        goal = {"waypoints": [{"position": [0.55, 2.9]}, {"t": 1.0, "configuration": FIRST}]}
        result = client.run(goal, feedback.append, silence=PATIENCE)
        assert (result["status"], result["configuration"]) == ("succeeded", FIRST)
        assert [message["waypoint"] for message in feedback[1:]] == [0, 1]
        before = states[-1]["measured"][0]
        assert client.request("jog", {"actuators": {"1.left": ["extended", "contracted"][before]}})["accepted"]
        eventually(lambda: states[-1]["measured"][0] == 1 - before)
        plan = client.request("plan", {"waypoints": [{"configuration": SECOND}]}, timeout=PATIENCE)
        assert plan["accepted"], plan
        assert plan["waypoints"][0]["configuration"] == SECOND
        later = {"id": "later", "waypoints": [{"configuration": FIRST}, {"t": HOUR, "configuration": SECOND}]}
        assert client.request("goal", later, timeout=PATIENCE)["accepted"]
        assert client.request("goal", later, timeout=PATIENCE)["id"] == "later"
        eventually(lambda: states[-1]["goal"] == "later")
        switches = result["switches"] + 1  # the executor sends its counts once a second
        eventually(lambda: sum(read(place.ledger)[0].values()) >= switches)
        (executor,) = executors(process)
        process.send(signal.SIGTERM)
        assert process.code == 0
        eventually(lambda: [r["status"] for r in results if r["id"] == "later"] == ["aborted"])
    assert gone(executor)
    ended = [(it["id"], it["status"]) for it in read(place.ledger)[1] if not it["id"].startswith("jog")]
    assert ended == [("later", "aborted"), (result["id"], "succeeded")]


def test_a_second_daemon_does_not_start_and_a_planner_ends_with_its_executor(place: Place) -> None:
    process = place.run("--simulate")
    with connected(place) as (client, states, results):
        nowhere = "tcp/127.0.0.1:0"
        second = place.run("--socket", str(place.folder), endpoint=nowhere)
        assert f"{place.ledger} is in use by process {process.pid}" in failure(second)
        third = place.run("--simulate", ledger=place.folder / "other.sqlite", endpoint=nowhere)
        assert "the executor ended with code" in failure(third)
        assert client.request("arm", timeout=PATIENCE)["daemon"]["pid"] == process.pid
        goal = {"id": "a", "waypoints": [{"configuration": FIRST}, {"t": HOUR, "configuration": SECOND}]}
        assert client.request("goal", goal, timeout=PATIENCE)["accepted"]
        eventually(lambda: states[-1]["goal"] == "a")
        os.kill(executors(process)[0], signal.SIGKILL)
        assert "the executor ended with code -9" in failure(process)
        eventually(lambda: [result["status"] for result in results] == ["aborted"])
        eventually(lambda: not client.alive())


def test_an_executor_that_runs_already_survives_the_planner(place: Place) -> None:
    words = ("--simulate", "--socket", str(place.folder / "planar16.sock"), "--journal", str(place.folder / "journal"))
    executor = place.start("execute", *words)
    process = place.run("--socket", str(place.folder), "--simulate")
    with connected(place) as (client, _, _):
        assert executors(process) == []
        process.send(signal.SIGINT)
        assert process.code == 0
        with pytest.raises(Unanswered):
            client.request("stop", timeout=1.0)
    assert executor.alive
    executor.end()
