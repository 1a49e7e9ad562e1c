"""Executors and planners as processes that tests start, stop and kill."""

import atexit
import functools
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from tests.waiting import eventually

ROOT = Path(__file__).parents[3]


class Process:
    """A command that was forked in a nursery."""

    def __init__(self, pid: int, log: Path) -> None:
        self.pid, self.log = pid, log

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

    @property
    def code(self) -> int:
        """The exit code, once the process has ended by itself."""
        self.gone()
        return int(Path(f"{self.log}.code").read_text())


class Nursery:
    """Forks commands of a kind, see nursery.py, in a process that has imported their modules."""

    module = "tests.system.stack.nursery"

    def __init__(self, kind: str, environment: dict[str, str], *files: Path) -> None:
        command = [sys.executable, "-m", self.module, kind, *map(str, files)]
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=os.environ | environment
        )
        self._ready = False

    def start(self, arguments: list[str], log: Path, environment: dict[str, str]) -> Process:
        with self._lock:
            if not self._ready:
                assert self._read() == "ready\n"
                self._ready = True
            log.touch()
            assert self._process.stdin
            self._process.stdin.write(json.dumps([arguments, str(log), environment]) + "\n")
            self._process.stdin.flush()
            return Process(int(self._read()), log)

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def _read(self) -> str:
        assert self._process.stdout
        return self._process.stdout.readline()


@functools.cache
def commands() -> Nursery:
    """Returns the process that forks commands of hyperbit for all tests of this one."""
    nursery = Nursery("hyperbit", {})
    atexit.register(nursery.close)
    return nursery


def tail(log: Path, lines: int = 30) -> str:
    return "\n".join(log.read_text().splitlines()[-lines:]) if log.exists() else "(no log)"
