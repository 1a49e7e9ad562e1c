"""Commands that run until a signal: their ends by a hang-up and SIGTERM, also at a terminal that stands still.

One function handles all signals, see tests/host/test_signals.py; only uvicorn, below the panel, tells them apart.
"""

from __future__ import annotations

import contextlib
import os
import pty
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from hyperbit.controller.network.session import configuration
from tests.commands.conftest import ARM
from tests.endpoints import free_endpoint
from tests.network.played import PlayedArm, Router
from tests.recorder.samples import written
from tests.shared import shared_folder
from tests.system.stack import arms, processes
from tests.system.stack.processes import Process
from tests.waiting import PATIENCE, eventually

pytestmark = pytest.mark.real_time
SERVING = {  # by command: its words, a text of its output once it serves
    "execute": ("execute {arm} --simulate --socket {folder} --journal {folder}/journal", "simulated in this process"),
    "panel": ("panel --listen 127.0.0.1:0 --connect {endpoint}", "hyperbit panel, viewer"),
    "record": ("record a --folder {folder}/recordings --connect {endpoint}", "nobody listens at"),
    "replay": ("replay {folder}/a.mcap --stay --listen {endpoint}", "replaying"),
    "ros2": ("ros2 a --connect {endpoint}", "nobody listens at"),
    "router": ("router --listen {endpoint}", "routing at"),
    "run": ("run {folder}/arm.yaml --simulate --listen {endpoint} --ledger {folder}/l.db", "serving the arm"),
    "simulate": ("simulate {folder}/arm.yaml", "faults to type"),
}
FOLLOWING = {"watch": "watch a --json --connect {endpoint}", "fleet": "fleet --follow --connect {endpoint}"}


class Commands:
    """Starts commands as processes; they are killed at the end."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self.log, self.endpoint, self._stack = folder, folder / "log", free_endpoint(), stack
        written(folder / "a.mcap").close()
        arms.write(folder, "planar", "shown", {"interface": "virtual", "channel": "can0"}, {"boards": arms.QUICK})

    def up(self, words: str, until: str = "", log: str = "", **environment: str) -> Process:
        """Starts a command, with its output in a file or terminal, and waits until it has printed a text."""
        environment |= dict.fromkeys(("STATE_DIRECTORY", "RUNTIME_DIRECTORY"), str(self.folder))
        environment |= {"XDG_CACHE_HOME": str(shared_folder() / "cache")}
        values = {"arm": ARM, "folder": self.folder, "endpoint": self.endpoint}
        process = processes.commands().start(words.format(**values).split(), Path(log or self.log), environment)
        self._stack.callback(process.kill)
        eventually(lambda: not process.alive or until in self.said(), told=self.said)
        assert process.alive, self.said()
        return process

    def said(self) -> str:
        return self.log.read_text(errors="replace") if self.log.exists() else ""  # a character may be half read

    def ended(self, process: Process) -> int:
        """Waits for the end of a command; returns its exit code."""
        code = process.code
        assert "Traceback" not in self.said()
        return code


@pytest.fixture
def commands(tmp_path: Path, stack: ExitStack) -> Commands:
    return Commands(tmp_path, stack)


def has(pid: int, mask: str, number: signal.Signals) -> bool:
    """Returns whether a process ignores a signal, with the mask SigIgn, or handles it, with SigCgt."""
    found = re.search(rf"{mask}:\s*([0-9a-f]+)", Path(f"/proc/{pid}/status").read_text())
    return found is not None and bool(int(found[1], 16) >> (number - 1) & 1)


@pytest.mark.parametrize(
    ("command", "number"),
    [*((command, signal.SIGHUP) for command in SERVING), ("panel", signal.SIGINT), ("panel", signal.SIGTERM)],
)
def test_a_signal_ends_a_command_in_order(commands: Commands, command: str, number: signal.Signals) -> None:
    process = commands.up(*SERVING[command])
    os.killpg(process.pid, number)
    assert commands.ended(process) == 0


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[tuple[int, str]]:
    """The user's end of a terminal, and the path of the other end. Its output goes to the log."""
    user, program = pty.openpty()

    def read() -> None:
        with contextlib.suppress(OSError), (tmp_path / "log").open("wb", 0) as log:
            while data := os.read(user, 4096):
                log.write(data)

    reading = threading.Thread(target=read)
    reading.start()
    yield user, os.ttyname(program)
    os.close(program)
    reading.join()
    os.close(user)


@pytest.mark.parametrize("command", SERVING)
def test_an_ignored_hang_up_ends_no_command_and_sigterm_does_at_a_paused_terminal(
    terminal: tuple[int, str], commands: Commands, command: str
) -> None:
    user, name = terminal
    process = commands.up(*SERVING[command], log=name, NOHUP="1")
    assert has(process.pid, "SigIgn", signal.SIGHUP)
    os.killpg(process.pid, signal.SIGHUP)
    os.write(user, b"\x13")  # Ctrl-S
    process.send(signal.SIGTERM)
    assert commands.ended(process) == 0


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 0), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
@pytest.mark.parametrize("command", FOLLOWING)
def test_a_signal_ends_what_follows_an_arm(
    commands: Commands, stack: ExitStack, command: str, number: signal.Signals, code: int
) -> None:
    router = Router(stack)
    commands.endpoint = router.endpoint
    arm = PlayedArm(stack, router.client())
    arm.state()
    process = commands.up(FOLLOWING[command])

    def heard() -> bool:
        arm.state()
        return "ready" in commands.said()

    eventually(heard, told=commands.said)
    os.killpg(process.pid, number)
    assert commands.ended(process) == code


@pytest.mark.parametrize("missing", [(1,), (0, 2)])
def test_missing_streams_are_replaced(tmp_path: Path, missing: tuple[int, ...]) -> None:
    def close() -> None:
        for number in missing:
            os.close(number)

    command = [sys.executable, "-m", "hyperbit", "execute", str(ARM), "--simulate", "--socket", str(tmp_path)]
    command += ["--journal", str(tmp_path / "journal")]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, preexec_fn=close)
    try:
        eventually(lambda: list(tmp_path.glob("*.sock")) and has(process.pid, "SigCgt", signal.SIGTERM))
        links = [os.readlink(f"/proc/{process.pid}/fd/{number}") for number in missing]
        process.terminate()
        assert process.wait(PATIENCE) == 0
        assert links == [os.devnull] * len(missing)
    finally:
        process.kill()
        process.wait()


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_a_demo_that_is_ended_ends_its_daemon(commands: Commands) -> None:
    process = commands.up("demo {arm}")
    (daemon,) = eventually(lambda: children(process.pid))
    eventually(lambda: children(daemon))  # the demo is past the start of its daemon
    process.send(signal.SIGHUP)
    assert commands.ended(process) == 128 + signal.SIGHUP
    assert not Path(f"/proc/{daemon}").exists()


def test_a_recording_is_replayed_to_its_end(commands: Commands) -> None:
    recording = commands.folder / "a.mcap"
    recording.write_bytes(recording.read_bytes()[:-20])
    words = "replay {folder}/a.mcap --speed 1000 --listen unixsock-stream/{folder}/z.sock"
    process = commands.up(words)
    assert commands.ended(process) == 0
    assert "is incomplete: its readable part is replayed" in commands.said()


def test_a_daemon_joins_a_router_that_comes_later_and_again_after_its_loss(commands: Commands) -> None:
    words = "run {folder}/arm.yaml --simulate --connect {endpoint} --ledger {folder}/ledger.sqlite"
    commands.up(words, "waiting for the Zenoh router")
    router, target = configuration("router", listen=commands.endpoint), "0" * 15 + "2"
    for _ in range(2):
        with zenoh.open(router), connected("shown", commands.endpoint, None) as client:
            eventually(client.alive)
            demo.wait_until_ready(client)
            assert client.run({"waypoints": [{"position": [0.5, 2.8]}]})["status"] == "succeeded"
            client.request("goal", {"waypoints": [{"configuration": target, "t": 1.0}]})
    with zenoh.open(router), connected("shown", commands.endpoint, None) as client:
        eventually(client.alive)  # it has finished the goal without the router, or does so now
        eventually(lambda: client.next_state().configuration == target)


def test_two_clients_meet_at_a_router(commands: Commands) -> None:
    commands.up(*SERVING["router"])
    one, other = (zenoh.open(configuration("client", connect=commands.endpoint)) for _ in range(2))
    with one, other, one.liveliness().declare_token("hyperbit/a/alive"):
        eventually(lambda: [it for it in other.liveliness().get("hyperbit/*/alive") if it.ok])
