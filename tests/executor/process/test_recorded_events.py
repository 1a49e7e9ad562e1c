"""The last events of the executor's process: saved after a fault, a kill and a request, and replayed."""

from __future__ import annotations

import contextlib
import re
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperbit.controller.host.keeper import KINDS, RefusedFile, ring_paths
from hyperbit.controller.program import Answer, PlayFault, Program, Snapshot, Stage, pack
from tests.executor.process.test_process import SIZE, Planner, Process
from tests.simulation.events import replay
from tests.simulation.loading import load
from tests.waiting import eventually


@pytest.fixture
def executor(tmp_path: Path) -> Iterator[Process]:
    executor = Process(tmp_path)
    yield executor
    if executor.process.poll() is None:
        executor.process.kill()
        executor.process.communicate()


def ready(executor: Process) -> tuple[Planner, Snapshot]:
    planner = Planner(executor.socket)
    return planner, planner.wait(Snapshot, lambda message: message.mode == "ready")


def saved(folder: Path, cause: str) -> Path:
    def found() -> list[Path]:
        return list(folder.glob(f"planar16.events-*-executor-{cause}-*"))

    (path,) = eventually(found)
    return path


def test_a_fault_saves_the_events_and_they_are_replayed(executor: Process, tmp_path: Path) -> None:
    planner, snapshot = ready(executor)
    stages = (Stage(pack(0b111, SIZE), at=0.0, mark=0),)
    planner.send(Program(1, snapshot.epoch, snapshot.outputs, 0.0, stages, True, True, "goal 1"))
    planner.wait(Snapshot, lambda message: message.mark == 0)
    planner.send(PlayFault(1, "error can0/5 2320"))
    assert planner.wait(Answer).accepted
    planner.wait(Snapshot, lambda message: message.mode == "fault")
    path = saved(tmp_path, "emergency")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert re.fullmatch(r"planar16\.events-\d{8}T\d{6}Z-executor-emergency-1", path.name)
    found = replay(load(path))
    assert (found.difference, found.skipped) == (None, 0)
    assert found.core.modes.mode == "fault"
    assert found.core.motion.actuation.states == 0b111
    paths = ring_paths("planar16", "executor", executor.process.pid)
    assert any(path.exists() for path in paths)
    code, _, err = executor.end()
    assert (code, "Traceback" in err, str(path) in err) == (0, False, True), err
    assert not any(path.exists() for path in paths)


def test_a_killed_executor_leaves_its_events(executor: Process, tmp_path: Path) -> None:
    planner, _ = ready(executor)
    for _ in range(2):  # what the last period brought is not written yet
        planner.wait(Snapshot)
    executor.process.send_signal(signal.SIGKILL)
    found = replay(load(saved(tmp_path, "killed")))
    assert (found.difference, found.core.modes.mode) == (None, "ready")
    assert not any(path.exists() for path in ring_paths("planar16", "executor", executor.process.pid))


def record_events(folder: Path, arm: str = "planar16") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hyperbit", "record", "--events", arm, "--folder", str(folder)]
    return subprocess.run(command, capture_output=True, text=True)


def pid_of(path: Path) -> int | None:
    """Returns the process that recorded events; None if another version did."""
    with contextlib.suppress(RefusedFile):
        return load(path)[0].about["pid"]
    return None


def test_a_request_saves_the_events_of_a_process_that_hangs(executor: Process, tmp_path: Path) -> None:
    ready(executor)
    executor.process.send_signal(signal.SIGSTOP)
    with contextlib.ExitStack() as stack:
        stack.callback(executor.process.send_signal, signal.SIGCONT)
        ended = record_events(tmp_path / "files")
    assert ended.returncode == 0, ended.stderr
    paths = [Path(line) for line in ended.stdout.splitlines() if "-executor-" in line]
    own = [path for path in paths if pid_of(path) == executor.process.pid]  # others may run on this computer
    assert len(own) == 1
    told = subprocess.run(
        [sys.executable, "-m", "tests.simulation", "--events", str(own[0])], capture_output=True, text=True
    )
    assert (told.returncode, "all actions reproduced" in told.stdout) == (0, True), told.stdout + told.stderr


def test_without_a_process_the_command_says_what_is_missing(tmp_path: Path) -> None:
    ended = record_events(tmp_path, "no-such-arm")
    assert (ended.returncode, ended.stdout) == (1, "")
    assert all(f"no {kind} of arm no-such-arm records events on this computer" in ended.stderr for kind in KINDS)
