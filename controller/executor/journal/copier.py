"""The executor's side of the copier: starts the process `journal_copy.py`, hears its messages and ends it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from hyperbit.controller.executor.journal import journal_copy
from hyperbit.controller.executor.journal.journal_copy import DiskCopy, JournalLayout

ENDING = 1.0  # [s] for the last copy
MOST = 1 << 16  # bytes of messages, the size of a pipe


class Copier:
    """A process that copies the switch journal to the disk. It ends by itself after this process, with a last copy.

    The process has a file of its own for the memory, so that it does not keep this process's lock on it. It shares the
    lock on the disk: another executor begins after the last copy. All signals are blocked, since a service manager or a
    terminal sends them to all processes of the executor.

    Args:
        path: of the file on the disk.
        layout: places of the records.
        memory: descriptor of the file in memory.
        disk: the file on the disk.
        interval: between two copies [s].

    Raises:
        OSError: the process cannot be started.
    """

    def __init__(self, path: Path, layout: JournalLayout, memory: int, disk: DiskCopy, interval: float) -> None:
        own = os.open(f"/proc/self/fd/{memory}", os.O_RDONLY | os.O_CLOEXEC)
        kept = -1 if disk.file is None else disk.file.fileno()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # the process inherits the mask
        try:
            self._process = subprocess.Popen(
                [
                    *[sys.executable, "-I", "-S", journal_copy.__file__],
                    *map(str, (path.absolute(), layout.size, own, kept, interval)),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                pass_fds=[number for number in (own, kept) if number >= 0],
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            os.close(own)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        os.set_blocking(self._output.fileno(), False)
        self._listening = True

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid

    def news(self) -> str | None:
        """Returns why the last copy failed, "" if it succeeded, None if nothing has changed. Never waits."""
        if not self._listening:
            return None
        try:
            content = os.read(self._output.fileno(), MOST)
        except BlockingIOError:
            return None
        if not content:
            self._listening = False
            return "the process that copies them has ended"
        return content.splitlines()[-1].decode(errors="replace")

    def end(self) -> bool:
        """Asks for the last copy and the end; returns whether the process has ended in time."""
        self._listening = False
        self._input.close()
        self._output.close()
        try:
            self._process.wait(ENDING)
        except subprocess.TimeoutExpired:
            return False
        return True
