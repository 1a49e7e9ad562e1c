"""`hyperbit execute` as a process, and a planner of its socket."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.program import MOST_BYTES, VERSION, Hello, Program, Snapshot, Stage, decode_up, encode, pack
from tests.keys import DEPLOY

SIZE = 48


class Process:
    """`hyperbit execute` on the arm of the paper, with simulated boards or with buses that do not exist."""

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

    def wait(self) -> tuple[int, str, str]:
        """Returns status, output and errors of the process when it has ended."""
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err

    def end(self) -> tuple[int, str, str]:
        self.process.send_signal(signal.SIGTERM)
        return self.wait()

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()


class Planner:
    """A planner at the socket of an executor."""

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

    def wait_for(self, mode: str) -> Snapshot:
        return self.wait(Snapshot, lambda snapshot: snapshot.mode == mode)

    def run(self, *states: int, step: float = 1000.0, context: bytes = b"") -> None:
        """Sends a program when the arm is ready."""
        ready = self.wait_for("ready")
        stages = tuple(Stage(pack(bits, SIZE), at=step * k, mark=k) for k, bits in enumerate(states))
        self.send(Program(1, ready.epoch, ready.outputs, 0.0, stages, True, False, "goal 1", context))
