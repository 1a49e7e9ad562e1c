"""The ends of commands that run until a signal: in order by a hang-up and SIGTERM, and on by an ignored hang-up.

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
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from tests.endpoints import free_endpoint
from tests.keys import DEPLOY
from tests.network.played import PlayedArm, Router
from tests.recorder.samples import written
from tests.system.stack import arms
from tests.waiting import PATIENCE, eventually

PAPER = str(DEPLOY / "planar16.yaml")
SERVING = {  # by command: its words, a text of its output once it serves
    "execute": ("execute {paper} --simulate --socket {folder} --journal {folder}/journal", "simulated in this process"),
    "panel": ("panel --listen 127.0.0.1:0 --connect {endpoint}", "hyperbit panel, viewer"),
    "record": ("record a --folder {folder}/recordings --connect {endpoint}", "nobody listens at"),
    "replay": ("replay {folder}/a.mcap --stay --listen {endpoint}", "replaying"),
    "ros2": ("ros2 a --connect {endpoint}", "nobody listens at"),
    "router": ("router --listen {endpoint}", "routing at"),
    "run": ("run {folder}/arm.yaml --simulate --listen {endpoint} --ledger {folder}/l.db", "serving the arm"),
    "simulate": ("simulate {folder}/arm.yaml", "faults to type"),
}
FOLLOWING = {"watch": "watch a --json --connect {there}", "fleet": "fleet --follow --connect {there}"}
Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture(scope="session")
def densities(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def start(tmp_path: Path, densities: Path) -> Iterator[Start]:
    """Runs a command in a process of its own, with SIGHUP ignored or not, until its log has a text."""
    written(tmp_path / "a.mcap").close()
    arms.write(tmp_path, "planar", "shown", {"interface": "virtual", "channel": "can0"}, {"boards": arms.QUICK})
    values = {"paper": PAPER, "folder": str(tmp_path), "endpoint": free_endpoint()}
    environment = {
        **os.environ, "XDG_CACHE_HOME": str(densities), "STATE_DIRECTORY": str(tmp_path),
        "RUNTIME_DIRECTORY": str(tmp_path), "PYTHONUNBUFFERED": "1",
    }  # fmt: skip
    begin = (
        "import signal, sys; signal.signal(signal.SIGHUP, signal.{}); from hyperbit.controller.cli import main; main()"
    )
    with ExitStack() as closing:

        def run(
            words: str, until: str, *, nohup: bool = False, terminal: int | None = None, **more: str
        ) -> subprocess.Popen[bytes]:
            command = [sys.executable, "-c", begin.format("SIG_IGN" if nohup else "SIG_DFL")]
            command += words.format(**values, **more).split()
            log = tmp_path / "log"
            output = closing.enter_context(log.open("wb")) if terminal is None else terminal
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=environment, process_group=0
            )
            closing.callback(process.wait)
            closing.callback(process.kill)
            said = partial(log.read_text, errors="replace")  # a character may be half read
            eventually(lambda: process.poll() is not None or until in said(), told=said)
            assert process.poll() is None, said()
            return process

        yield run


def has(process: subprocess.Popen[bytes], mask: str, number: signal.Signals) -> bool:
    """Returns whether a process ignores a signal, with the mask SigIgn, or handles it, with SigCgt."""
    found = re.search(rf"{mask}:\s*([0-9a-f]+)", Path(f"/proc/{process.pid}/status").read_text())
    return found is not None and bool(int(found[1], 16) >> (number - 1) & 1)


@pytest.mark.parametrize(
    ("command", "number"),
    [*((command, signal.SIGHUP) for command in SERVING), ("panel", signal.SIGINT), ("panel", signal.SIGTERM)],
)
def test_a_signal_ends_a_command_in_order(start: Start, tmp_path: Path, command: str, number: signal.Signals) -> None:
    process = start(*SERVING[command])
    os.killpg(process.pid, number)
    assert process.wait(PATIENCE) == 0
    assert "Traceback" not in (tmp_path / "log").read_text()


@pytest.mark.parametrize("command", SERVING)
def test_an_ignored_hang_up_ends_no_command_and_sigterm_does(start: Start, tmp_path: Path, command: str) -> None:
    process = start(*SERVING[command], nohup=True)
    assert has(process, "SigIgn", signal.SIGHUP)
    os.killpg(process.pid, signal.SIGHUP)
    os.killpg(process.pid, signal.SIGTERM)
    assert process.wait(PATIENCE) == 0
    assert "Traceback" not in (tmp_path / "log").read_text()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 0), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
@pytest.mark.parametrize("command", FOLLOWING)
def test_a_signal_ends_what_follows_an_arm(
    start: Start, tmp_path: Path, command: str, number: signal.Signals, code: int
) -> None:
    with ExitStack() as closing:
        router = Router(closing)
        arm = PlayedArm(closing, router.client())
        arm.state()
        process = start(FOLLOWING[command], "", there=router.endpoint)

        def heard() -> bool:
            arm.state()
            return "ready" in (tmp_path / "log").read_text()

        eventually(heard)
        os.killpg(process.pid, number)
        assert process.wait(PATIENCE) == code
        assert "Traceback" not in (tmp_path / "log").read_text()


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[tuple[int, int]]:
    """Both ends of a terminal, the user's first. Its output goes to the log. Ask for it before `start`."""
    user, program = pty.openpty()

    def read() -> None:
        with contextlib.suppress(OSError), (tmp_path / "log").open("wb", 0) as log:
            while data := os.read(user, 4096):
                log.write(data)

    reading = threading.Thread(target=read)
    reading.start()
    yield user, program
    os.close(program)
    reading.join()
    os.close(user)


@pytest.mark.parametrize("command", SERVING)
def test_a_paused_terminal_keeps_no_command_from_its_end(
    terminal: tuple[int, int], start: Start, tmp_path: Path, command: str
) -> None:
    user, program = terminal
    process = start(*SERVING[command], terminal=program)
    os.write(user, b"\x13")  # Ctrl-S
    process.terminate()
    assert process.wait(PATIENCE) == 0
    assert "Traceback" not in (tmp_path / "log").read_text()


@pytest.mark.parametrize("missing", [(0,), (1,), (2,), (0, 1, 2)])
def test_missing_streams_are_replaced(tmp_path: Path, missing: tuple[int, ...]) -> None:
    def close() -> None:
        for number in missing:
            os.close(number)

    command = [sys.executable, "-m", "hyperbit", "execute", PAPER, "--simulate", "--socket", str(tmp_path)]
    command += ["--journal", str(tmp_path / "journal")]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, preexec_fn=close)
    try:
        eventually(lambda: list(tmp_path.glob("*.sock")) and has(process, "SigCgt", signal.SIGTERM))
        links = [os.readlink(f"/proc/{process.pid}/fd/{number}") for number in missing]
        process.terminate()
        assert process.wait(PATIENCE) == 0
        assert links == [os.devnull] * len(missing)
    finally:
        process.kill()
        process.wait()


def test_a_demo_that_is_ended_ends_its_daemon(start: Start) -> None:
    process = start("demo {paper}", "")
    (daemon,) = eventually(lambda: children(process.pid))
    eventually(lambda: children(daemon))  # the demo is past the start of its daemon
    process.send_signal(signal.SIGHUP)
    assert process.wait(PATIENCE) == 128 + signal.SIGHUP
    assert not Path(f"/proc/{daemon}").exists()


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
