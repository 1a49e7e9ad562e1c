"""The executor's process: start, socket and end; its loaded modules and its memory."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.program import (
    MOST_BYTES,
    VERSION,
    Acknowledge,
    Answer,
    Ended,
    Goodbye,
    Hello,
    PlayFault,
    Program,
    Snapshot,
    Stage,
    Welcome,
    decode_up,
    encode,
    pack,
)
from hyperbit.controller.refusals.reasons import Reason
from tests.keys import DEPLOY

FORBIDDEN = {"numba", "llvmlite", "scipy", "zenoh", "matplotlib", "rich", "typer", "filterpy"}
OWN = ("armfile", "decoding", "executor", "flight_recorder", "host", "program", "refusals")
ROOMS = {f"hyperbit.controller.{name}" for name in OWN}
MOST_RESIDENT = 80 * 1024  # [kB]
SIMULATION = {"canopen", "hyperbit.drivers.simulation"}  # a real arm's process loads neither
SIZE = 48


class Process:
    """`hyperbit execute` on an arm of the paper, with simulated boards or with buses that do not exist."""

    def __init__(self, folder: Path, *options: str, simulate: bool = True) -> None:
        self.socket = folder / "planar16.sock"
        arm = patient_copy(Path(DEPLOY) / "planar16.yaml", folder)
        if not simulate:  # an interface has one executor, and other tests may run one
            arm.write_text(arm.read_text().replace("channel: can0", f"channel: none{os.getpid()}"))
        arguments = [sys.executable, "-m", "hyperbit.controller.cli", "execute", str(arm), *["--simulate"] * simulate]
        self.process = subprocess.Popen(
            [*arguments, "--socket", str(folder), "--journal", str(folder / "journal"), *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def end(self) -> tuple[int, str, str]:
        self.process.send_signal(signal.SIGTERM)
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err


class Planner:
    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.settimeout(60)
        for _ in range(600):
            with contextlib.suppress(OSError):
                self.socket.connect(str(path))
                break
            time.sleep(0.05)
        self.send(Hello(VERSION, "planner", "planar16"))

    def send(self, message: Any) -> None:
        self.socket.send(encode(message))

    def wait(self, kind: type, holds: Any = lambda message: True) -> Any:
        while True:
            message = decode_up(self.socket.recv(MOST_BYTES))
            if isinstance(message, kind) and holds(message):
                return message


@pytest.fixture
def executor(tmp_path: Path) -> Iterator[Process]:
    executor = Process(tmp_path, "--list-modules")
    yield executor
    if executor.process.poll() is None:
        executor.process.kill()
        executor.process.communicate()


def resident(pid: int) -> int:
    """Greatest resident memory of a process so far [kB]."""
    (line,) = (line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1])


def test_a_program_is_run_and_nothing_is_loaded_that_a_loop_has_no_use_for(executor: Process, tmp_path: Path) -> None:
    planner = Planner(executor.socket)
    assert planner.wait(Welcome).arm == "planar16"
    ready = planner.wait(Snapshot, lambda message: message.mode == "ready")
    stages = (Stage(pack(0b111, SIZE), at=0.0, mark=0),)
    planner.send(Program(1, ready.epoch, ready.outputs, 0.0, stages, True, True, "goal 1"))
    ended = planner.wait(Ended)
    assert (ended.status, ended.switches, ended.measured) == ("done", 3, pack(0b111, SIZE))
    planner.send(Acknowledge(ended.result))
    second = Planner(executor.socket)
    assert f"process {os.getpid()}" in second.wait(Goodbye).reason
    assert resident(executor.process.pid) <= MOST_RESIDENT
    mapped = Path(f"/proc/{executor.process.pid}/maps").read_text()
    assert not [name for name in FORBIDDEN if f"/{name}/" in mapped]
    other = Process(tmp_path)
    _, err = other.process.communicate(timeout=60)
    assert other.process.returncode == 1
    assert f"process {executor.process.pid}" in err
    executor.process.stdin.write("stick 1.left 0\nnonsense\n")
    executor.process.stdin.flush()
    assert executor.process.stdout.readline() == "done: stick 1.left 0\n"
    code, out, err = executor.end()
    assert code == 0, err
    assert "not done: 'nonsense' is no fault" in err
    loaded = set(out.split())
    assert not FORBIDDEN & {name.split(".")[0] for name in loaded}
    rooms = {".".join(name.split(".")[:3]) for name in loaded if name.startswith("hyperbit.controller.")}
    assert rooms <= ROOMS
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


def test_a_client_plays_faults_in_simulated_boards(executor: Process) -> None:
    planner = Planner(executor.socket)
    simulation = planner.wait(Welcome).simulation
    assert simulation.boards[:2] == ("can0/1", "can0/2")
    assert {"silence", "stick", "open"} <= {verb.verb for verb in simulation.faults}
    planner.wait(Snapshot, lambda message: message.mode == "ready")
    for number, (text, said) in enumerate(
        [
            ("error can0/5 2320", "done: error can0/5 2320"),
            ("error can0/55 2320", "'can0/55' is no board: did you mean can0/5? Boards: can0/1, can0/2"),
        ]
    ):
        planner.send(PlayFault(number, text))
        answer = planner.wait(Answer)
        assert (answer.request, answer.message.startswith(said)) == (number, True), answer
        assert answer.accepted == said.startswith("done")
    faults = planner.wait(Snapshot, lambda message: message.mode == "fault").faults
    assert ("emergency", "can0/5") in {(fault.code, fault.source) for fault in faults}


def test_a_variant_without_simulated_boards_is_refused(tmp_path: Path) -> None:
    process = Process(tmp_path, "--board", "wago", simulate=False)
    _, err = process.process.communicate(timeout=60)
    assert (process.process.returncode, "needs --simulate" in err) == (2, True), err


def test_an_ended_executor_gives_its_result_and_counts_go_on(tmp_path: Path) -> None:
    executor = Process(tmp_path)
    planner = Planner(executor.socket)
    ready = planner.wait(Snapshot, lambda message: message.mode == "ready")
    stages = (Stage(pack(1, SIZE), at=0.0, mark=0), Stage(pack(0, SIZE), at=1000.0, mark=1))
    planner.send(Program(1, ready.epoch, ready.outputs, 0.0, stages, True, False, "goal 1", b"context"))
    planner.wait(Snapshot, lambda message: message.mark == 0)
    code, _, err = executor.end()
    assert (code, "Traceback" in err) == (0, False)
    ended = planner.wait(Ended)
    assert (ended.status, ended.context, ended.switches) == ("aborted", b"context", 1)
    executor = Process(tmp_path)
    assert Planner(executor.socket).wait(Welcome).counts[:2] == (1, 0)
    assert executor.end()[0] == 0


def test_unusable_input_ends_with_2(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-m", "hyperbit.controller.executor", str(tmp_path / "none.yaml")],
        capture_output=True,
        text=True,
    )
    assert (run.returncode, "no such file" in run.stderr) == (2, True)


def test_all_arms_of_a_computer_are_halted_without_planner_and_zenoh(executor: Process) -> None:
    planner = Planner(executor.socket)
    planner.wait(Snapshot, lambda message: message.mode == "ready")
    folder = str(executor.socket.parent)
    script = (
        "import sys; from controller import cli; sys.argv[1:] = ['halt', '--socket', sys.argv[1]]\n"
        "try: cli.main()\n"
        "except SystemExit: pass\n"
        "assert not {'zenoh', 'numpy', 'rich', 'numba'} & set(sys.modules), set(sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", script, folder], capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (0, "planar16: stopped; the arm holds until reset\n"), run.stderr
    planner.wait(Snapshot, lambda message: message.mode == "stopped")


def test_signals_at_the_end_change_nothing(executor: Process) -> None:
    planner = Planner(executor.socket)
    planner.wait(Snapshot, lambda message: message.mode == "ready")
    while executor.process.poll() is None:
        executor.process.send_signal(signal.SIGTERM)
        time.sleep(0.0005)
    _, err = executor.process.communicate(timeout=60)
    assert (executor.process.returncode, "Errno" in err, "Traceback" in err) == (0, False, False), err
