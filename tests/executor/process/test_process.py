"""The executor's process: start, socket and end; its loaded modules and memory; its last events."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperbit.controller.host.keeper import KINDS, RefusedFile, ring_paths
from hyperbit.controller.program import Acknowledge, Answer, Ended, Goodbye, PlayFault, Settled, Snapshot, Welcome, pack
from hyperbit.controller.refusals.reasons import Reason
from tests.executor.process.rig import SIZE, Planner, Process
from tests.simulation.events import replay
from tests.simulation.loading import load
from tests.waiting import eventually

FORBIDDEN = {"numba", "llvmlite", "scipy", "zenoh", "matplotlib", "rich", "typer", "filterpy"}
OWN = ("armfile", "decoding", "executor", "flight_recorder", "host", "messages", "program", "refusals")
ROOMS = {f"hyperbit.controller.{name}" for name in OWN}
MOST_RESIDENT = 80 * 1024  # [kB]
SIMULATION = {"canopen", "hyperbit.drivers.simulation"}  # a real arm's process loads neither


@pytest.fixture
def executor(tmp_path: Path) -> Iterator[Process]:
    executor = Process(tmp_path, "--list-modules")
    yield executor
    executor.kill()


def resident(pid: int) -> int:
    """Greatest resident memory of a process so far [kB]."""
    (line,) = (line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1])


def saved(folder: Path, cause: str) -> Path:
    (path,) = eventually(lambda: list(folder.glob(f"planar16.events-*-executor-{cause}-*")))
    return path


def test_a_program_is_run_and_nothing_is_loaded_that_a_loop_has_no_use_for(executor: Process, tmp_path: Path) -> None:
    planner = Planner(executor.socket)
    welcome = planner.wait(Welcome)
    assert (welcome.arm, welcome.simulation.boards[:2]) == ("planar16", ("can0/1", "can0/2"))
    assert {"silence", "stick", "open"} <= {verb.verb for verb in welcome.simulation.faults}
    planner.run(0b111)
    ended = planner.wait(Ended)
    assert (ended.status, ended.switches, ended.measured) == ("done", 3, pack(0b111, SIZE))
    planner.send(Acknowledge(ended.result))
    assert f"process {os.getpid()}" in Planner(executor.socket).wait(Goodbye).reason
    assert resident(executor.process.pid) <= MOST_RESIDENT
    mapped = Path(f"/proc/{executor.process.pid}/maps").read_text()
    assert not [name for name in FORBIDDEN if f"/{name}/" in mapped]
    code, _, err = Process(tmp_path).wait()
    assert (code, f"process {executor.process.pid}" in err) == (1, True)
    executor.process.stdin.write("stick 1.left 0\nnonsense\n")
    executor.process.stdin.flush()
    assert executor.process.stdout.readline() == "done: stick 1.left 0\n"
    code, out, err = executor.end()
    assert (code, "not done: 'nonsense' is no fault" in err) == (0, True), err
    loaded = set(out.split())
    assert not FORBIDDEN & {name.split(".")[0] for name in loaded}
    assert {".".join(name.split(".")[:3]) for name in loaded if name.startswith("hyperbit.controller.")} <= ROOMS
    assert not executor.socket.exists()


def test_without_simulated_boards_neither_simulation_nor_canopen_is_loaded(tmp_path: Path) -> None:
    process = Process(tmp_path, "--list-modules", simulate=False)
    planner = Planner(process.socket)
    welcome = planner.wait(Welcome)
    assert (welcome.arm, welcome.simulation) == ("planar16", None)
    planner.send(PlayFault(7, "silence can0/5"))
    answer = planner.wait(Answer)
    assert (answer.request, answer.refused.reason) == (7, Reason.NOT_SIMULATED)
    code, out, err = process.end()
    assert code == 0, err
    loaded = set(out.split())
    assert "hyperbit.controller.executor.process.buses" in loaded
    assert not [name for name in loaded if any(f"{name}.".startswith(f"{room}.") for room in SIMULATION)]


def test_unusable_input_ends_with_2(tmp_path: Path) -> None:
    code, _, err = Process(tmp_path, "--board", "wago", simulate=False).wait()
    assert (code, "needs --simulate" in err) == (2, True), err
    run = subprocess.run(
        [sys.executable, "-m", "hyperbit.controller.executor", str(tmp_path / "none.yaml")],
        capture_output=True,
        text=True,
    )
    assert (run.returncode, "no such file" in run.stderr) == (2, True)


def test_an_ended_executor_gives_its_result_and_counts_go_on(tmp_path: Path) -> None:
    executor = Process(tmp_path)
    planner = Planner(executor.socket)
    planner.run(1, 0, context=b"context")
    planner.wait(Settled)
    code, _, err = executor.end()
    assert (code, "Traceback" in err) == (0, False)
    ended = planner.wait(Ended)
    assert (ended.status, ended.context, ended.switches) == ("aborted", b"context", 1)
    executor = Process(tmp_path)
    assert Planner(executor.socket).wait(Welcome).counts[:2] == (1, 0)
    executor.process.send_signal(signal.SIGTERM)
    while executor.process.poll() is None:  # signals at the end change nothing
        executor.process.send_signal(signal.SIGTERM)
        time.sleep(0.0005)
    code, _, err = executor.wait()
    assert (code, "Errno" in err, "Traceback" in err) == (0, False, False), err


def test_all_arms_of_a_computer_are_halted_without_planner_and_zenoh(executor: Process) -> None:
    planner = Planner(executor.socket)
    planner.wait_for("ready")
    script = (
        "import sys; from controller import cli; sys.argv[1:] = ['halt', '--socket', sys.argv[1]]\n"
        "try: cli.main()\n"
        "except SystemExit: pass\n"
        "assert not {'zenoh', 'numpy', 'rich', 'numba'} & set(sys.modules), set(sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", script, executor.socket.parent], capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (0, "planar16: stopped; the arm holds until reset\n"), run.stderr
    planner.wait_for("stopped")


def test_a_fault_saves_the_events_and_they_are_replayed(executor: Process, tmp_path: Path) -> None:
    planner = Planner(executor.socket)
    planner.run(0b111)
    planner.wait(Settled)
    planner.send(PlayFault(1, "error can0/55 2320"))
    assert planner.wait(Answer).message.startswith("'can0/55' is no board: did you mean can0/5? Boards: can0/1, can0/2")
    planner.send(PlayFault(2, "error can0/5 2320"))
    assert planner.wait(Answer) == Answer(2, "done: error can0/5 2320")
    assert ("emergency", "can0/5") in {(fault.code, fault.source) for fault in planner.wait_for("fault").faults}
    path = saved(tmp_path, "emergency")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert re.fullmatch(r"planar16\.events-\d{8}T\d{6}Z-executor-emergency-1", path.name)
    found = replay(load(path))
    assert (found.difference, found.skipped) == (None, 0)
    assert (found.core.modes.mode, found.core.motion.actuation.states) == ("fault", 0b111)
    paths = ring_paths("planar16", "executor", executor.process.pid)
    assert any(path.exists() for path in paths)
    code, _, err = executor.end()
    assert (code, "Traceback" in err, str(path) in err) == (0, False, True), err
    assert not any(path.exists() for path in paths)


def record_events(folder: Path, arm: str = "planar16") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hyperbit", "record", "--events", arm, "--folder", str(folder)]
    return subprocess.run(command, capture_output=True, text=True)


def pid_of(path: Path) -> int | None:
    """Returns the process that recorded events; None if another version did."""
    with contextlib.suppress(RefusedFile):
        return load(path)[0].about["pid"]
    return None


def test_events_of_a_process_that_hangs_are_saved_on_request_and_those_of_a_killed_one_by_themselves(
    executor: Process, tmp_path: Path
) -> None:
    planner = Planner(executor.socket)
    planner.wait_for("ready")
    for _ in range(2):  # what the last period brought is not written yet
        planner.wait(Snapshot)
    executor.process.send_signal(signal.SIGSTOP)
    ended = record_events(tmp_path / "files")
    assert ended.returncode == 0, ended.stderr
    paths = [Path(line) for line in ended.stdout.splitlines() if "-executor-" in line]
    own = [path for path in paths if pid_of(path) == executor.process.pid]  # others may run on this computer
    assert len(own) == 1
    command = [sys.executable, "-m", "tests.simulation", "--events", str(own[0])]
    told = subprocess.run(command, capture_output=True, text=True)
    assert (told.returncode, "all actions reproduced" in told.stdout) == (0, True), told.stdout + told.stderr
    executor.process.send_signal(signal.SIGKILL)
    found = replay(load(saved(tmp_path, "killed")))
    assert (found.difference, found.core.modes.mode) == (None, "ready")
    assert not any(path.exists() for path in ring_paths("planar16", "executor", executor.process.pid))


def test_without_a_process_the_command_that_saves_events_says_what_is_missing(tmp_path: Path) -> None:
    ended = record_events(tmp_path, "no-such-arm")
    assert (ended.returncode, ended.stdout) == (1, "")
    assert all(f"no {kind} of arm no-such-arm records events on this computer" in ended.stderr for kind in KINDS)
