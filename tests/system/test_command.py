"""The command `hyperbit run --simulate` as a person starts it: planner, executor, and their ends."""

import contextlib
import os
import pty
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client
from hyperbit.controller.planning.ledger_file import read
from tests.endpoints import free_endpoint
from tests.shared import shared_folder
from tests.system.stack import arms
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT
from tests.system.stack.processes import ROOT
from tests.waiting import PATIENCE, eventually

pytestmark = pytest.mark.buses("virtual")  # the boards are in the executor

RUN = "import sys, typer; from hyperbit.controller.commands.operate.run import run; typer.run(run)"
NAME = "demonstrated"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    arms.write(tmp_path, "planar", NAME, {"channel": "can0", "bitrate": 123_456}, {"boards": arms.QUICK})
    return tmp_path


@contextlib.contextmanager
def started(folder: Path, output: int) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-c", RUN, str(folder / "arm.yaml"), "--simulate", "--listen", endpoint(folder)]
    folders = dict.fromkeys(("STATE_DIRECTORY", "RUNTIME_DIRECTORY"), str(folder))
    folders |= {"XDG_CACHE_HOME": str(shared_folder() / "cache"), "PYTHONPATH": str(ROOT)}
    environment = {**os.environ, **folders, "NOTIFY_SOCKET": ""}
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=output, env=environment, process_group=0)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def process(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    with (folder / "log").open("wb") as log, started(folder, log.fileno()) as process:
        yield process


def endpoint(folder: Path) -> str:
    """The endpoint of a folder's daemon; the same at each call."""
    file = folder / "endpoint"
    if not file.exists():
        file.write_text(free_endpoint())
    return file.read_text()


@contextlib.contextmanager
def connected(process: subprocess.Popen[bytes], folder: Path) -> Iterator[Observer]:
    def connect() -> zenoh.Session | None:
        assert process.poll() is None
        try:
            return zenoh.open(session.configuration("client", connect=endpoint(folder)))
        except zenoh.ZError:
            return None

    with eventually(connect, 2 * PATIENCE) as opened:
        client = Observer(Client(opened, NAME))
        client.wait_for("ready")
        yield client


@pytest.fixture
def client(process: subprocess.Popen[bytes], folder: Path) -> Iterator[Observer]:
    with connected(process, folder) as client:
        yield client


def children(process: subprocess.Popen[bytes]) -> list[int]:
    """Returns the ids of the child processes of a process, but the keeper of its events."""
    others = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [int(pid) for pid in others if b"keeper.py" not in Path(f"/proc/{pid}/cmdline").read_bytes()]


def test_a_paused_terminal_stops_neither_states_nor_answers_nor_results(folder: Path) -> None:
    user, program = pty.openpty()
    termios.tcflow(program, termios.TCOOFF)  # as Ctrl-S does
    with started(folder, program) as process, connected(process, folder) as client:
        client.move(MIDDLE)
        client.goal(RIGHT, LEFT, times=[HOUR, 2 * HOUR], id="b")
        client.wait_for("executing", "goal b")
        assert client.ask("stop")["accepted"]
        client.wait_for("stopped")
        assert client.result("b")["status"] == "aborted"
        process.terminate()
        assert process.wait(PATIENCE) == 0
    os.close(user)
    os.close(program)


def test_ctrl_c_ends_both_processes_in_order(process: subprocess.Popen[bytes], client: Observer, folder: Path) -> None:
    (executor,) = children(process)
    client.move(MIDDLE, goal="a")
    client.goal(RIGHT, LEFT, times=[HOUR, 2 * HOUR], id="b")
    client.wait_for("executing", "goal b")
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does; tests/commands/test_ending.py has other signals
    assert process.wait(PATIENCE) == 0
    assert "ERROR" not in (log := (folder / "log").read_text()), log
    assert log.count("buses[1].bitrate: 123456 bit/s is unusual") == 1, log
    assert not [fault for state in client.heard["state"] for fault in state["faults"]]
    result = client.result("b")
    assert (result["status"], result["message"]) == ("aborted", "the daemon is shutting down")
    switches, goals = read(folder / "simulated" / f"{NAME}.sqlite")
    assert [(goal["id"], goal["status"]) for goal in goals] == [("b", "aborted"), ("a", "succeeded")]
    assert sum(switches.values()) == client.result("a")["switches"]
    assert (folder / "simulated" / f"{NAME}.switches").exists()
    real = [folder / f"{NAME}{suffix}" for suffix in (".sqlite", ".switches")]
    assert not any(path.exists() for path in real), "simulation counts nothing as real"
    eventually(lambda: not os.path.exists(f"/proc/{executor}"))


def test_a_killed_planner_takes_its_executor_with_it(process: subprocess.Popen[bytes], client: Observer) -> None:
    """That the planner ends with its executor is tested in tests/gateway/test_daemon.py."""
    (executor,) = children(process)
    eventually(lambda: client.client.alive())
    process.kill()
    eventually(lambda: not os.path.exists(f"/proc/{executor}"))
    eventually(lambda: not client.client.alive())


def test_faults_of_simulated_boards_are_made_by_lines_on_the_standard_input_and_by_the_command(
    process: subprocess.Popen[bytes], client: Observer, folder: Path
) -> None:
    def say(line: str) -> None:
        assert process.stdin
        process.stdin.write(f"{line}\n".encode())
        process.stdin.flush()

    def fault(*words: str) -> tuple[int, str]:
        command = [sys.executable, "-m", "hyperbit", "fault", NAME, *words, "--connect", endpoint(folder)]
        run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        return run.returncode, (run.stdout + run.stderr).replace("\n", " ")

    say("silence can0/5")
    assert "can0/5" in client.wait_for("fault")["reason"]
    say("no such fault")
    say("unsilence can0/5")
    client.reset()  # needed if reads without an answer were the fault, before the heartbeat was overdue
    client.move(MIDDLE)

    assert client.heard["state"][-1]["simulated"] is True
    assert fault("silence", "can0/6") == (0, "done: silence can0/6 ")
    assert "can0/6" in client.wait_for("fault", after=len(client.heard["state"]))["reason"]  # lost, or not verified
    code, said = fault("unsilense", "can0/6")
    assert (code, "did you mean unsilence?" in said, "hyperbit fault --help" in said) == (1, True, True), said
    assert fault("unsilence", "can0/6") == (0, "done: unsilence can0/6 ")
    client.reset()
    client.move(RIGHT, goal="after")
