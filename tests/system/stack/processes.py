"""Executors and planners as processes that tests start, stop and kill."""

import atexit
import functools
import json
import os
import shlex
import signal
import socket
import subprocess
import sys
from pathlib import Path

from tests.shared import shared_folder
from tests.system.stack import arms
from tests.waiting import eventually

ROOT = Path(__file__).parents[3]
APPEND = os.O_WRONLY | os.O_CREAT | os.O_APPEND
SCRIPT = """#!/bin/sh
exec {python} -IS -c 'import json, os, socket, sys
with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as there:
    there.connect({path})
    order = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()
    socket.send_fds(there, [order], [0, 1, 2])
    there.recv(100)
    code = int(there.recv(100) or 70)
sys.exit(code if code >= 0 else 128 - code)
' "$@"
"""


class Process:
    """A command that was forked in a nursery."""

    def __init__(self, pid: int, log: Path, connection: socket.socket) -> None:
        self.pid, self.log, self._connection = pid, log, connection

    @property
    def alive(self) -> bool:
        return os.path.exists(f"/proc/{self.pid}")

    def send(self, number: signal.Signals) -> None:
        os.kill(self.pid, number)

    def freeze(self) -> None:
        """Stops the process, and waits until all its threads stand still."""
        self.send(signal.SIGSTOP)
        eventually(lambda: Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T")

    def thaw(self) -> None:
        self.send(signal.SIGCONT)

    def end(self, number: signal.Signals = signal.SIGTERM) -> None:
        if self.alive:
            self.send(number)
            self.gone()

    def gone(self) -> None:
        eventually(lambda: not self.alive, told=lambda: f"of process {self.pid}: {tail(self.log)}")

    def kill(self) -> None:
        self.end(signal.SIGKILL)

    @functools.cached_property
    def code(self) -> int:
        """The exit code, once the process has ended; negative after a signal."""
        self.gone()
        return int(self._connection.recv(100))


class Nursery:
    """Forks commands of a kind, see nursery.py, in a process that has imported their modules.

    Its creator ends it; processes that the creator forks may use it.
    """

    def __init__(self, kind: str, folder: Path, *files: Path, module: str = "tests.system.stack.nursery") -> None:
        self._path, self._creator = folder / f"{module.rpartition('.')[2]}-{kind}", os.getpid()
        command = [sys.executable, "-m", module, str(self._path), kind, *map(str, files)]
        environment = os.environ | {"XDG_CACHE_HOME": str(folder / "cache"), "PYTHONUNBUFFERED": "1"}
        nothing, pipe = subprocess.DEVNULL, subprocess.PIPE  # a pipe, for commands may have no file that can be sought
        self._process = subprocess.Popen(command, stdin=nothing, stdout=pipe, stderr=pipe, cwd=ROOT, env=environment)

    def start(self, arguments: list[str], log: Path, environment: dict[str, str]) -> Process:
        """Starts a command in the current folder, with its output at the end of a file, or in a terminal.

        Args:
            environment: beside the one of this process.
        """
        self.wait()
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        connection.connect(str(self._path))
        order = json.dumps([arguments, os.getcwd(), os.environ | environment]).encode()
        streams = [os.open(name, flags | os.O_NOCTTY) for name, flags in ((os.devnull, os.O_RDONLY), (log, APPEND))]
        socket.send_fds(connection, [order], [*streams, streams[1]])
        for stream in streams:
            os.close(stream)
        return Process(int(connection.recv(100)), log, connection)

    def wait(self) -> None:
        """Waits until the process has imported its modules, and takes commands."""
        eventually(self._path.exists, told=lambda: f"the process that forks commands does not listen at {self._path}")

    def script(self) -> str:
        """Returns a program that does what the command does."""
        self.wait()
        return SCRIPT.format(python=shlex.quote(sys.executable), path=json.dumps(str(self._path)))

    def close(self) -> None:
        if os.getpid() == self._creator:
            self._process.kill()
            self._process.wait()


@functools.cache
def nursery(kind: str) -> Nursery:
    """Returns the process that forks commands of a kind, for this process and for those that it forks later."""
    files = [arms.write(shared_folder(), "planar", "none", arms.NO_BUS, {})] if kind == "planner" else []
    made = Nursery(kind, shared_folder(), *files)
    atexit.register(made.close)
    return made


def commands() -> Nursery:
    return nursery("hyperbit")


def tail(log: Path, lines: int = 30) -> str:
    return "\n".join(log.read_text().splitlines()[-lines:]) if log.exists() else "(no log)"
