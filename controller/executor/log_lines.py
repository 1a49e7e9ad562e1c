"""Log lines on the standard error, written by the event loop's own thread: a reader that hangs must not stop it.

A second thread would hold the interpreter now and then. Without a real-time priority of its own it would not get on
while other processes are busy, and the event loop would wait for it. Only where the standard error is a file does a
thread write, as a write to a disk can wait for a tenth of a second.
"""

import logging
import os
import queue
import select
import stat
import sys
from collections import deque
from collections.abc import Callable
from logging.handlers import QueueHandler, QueueListener

from controller.journal import JournalHandler, is_journal

MOST_WAITING = 1_000  # log lines; more are dropped
MOST_WRITTEN = 4_096  # bytes at once; a pipe that can be written takes so many without waiting
PATIENCE = 0.5  # [s] for lines that wait at the end


class LogLines(logging.Handler):
    """Writes each line at once if that does not wait, else with a later line.

    Args:
        output: file descriptor.
    """

    def __init__(self, output: int) -> None:
        super().__init__()
        self._output, self._waiting = output, deque[bytes]()

    def emit(self, record: logging.LogRecord) -> None:
        """Writes a record, or keeps it, or drops it if too many wait."""
        try:
            line = (self.format(record) + "\n").encode(errors="backslashreplace")
        except Exception:  # a message that does not fit its arguments must not stop the arm
            line = f"{record.levelname} {record.name}: a line cannot be written: {record.msg!r}\n".encode()
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append(line)
        self._write(0.0)

    def close(self) -> None:
        """Writes what waits, as far as it is read."""
        self._write(PATIENCE)
        super().close()

    def _write(self, patience: float) -> None:
        """Writes while the output takes it; waits for so long each time [s]."""
        try:
            while self._waiting and select.select([], [self._output], [], patience)[1]:
                line = self._waiting.popleft()
                written = os.write(self._output, line[:MOST_WRITTEN])
                if written < len(line):
                    self._waiting.appendleft(line[written:])
        except (OSError, ValueError):  # nobody reads any more
            self._waiting.clear()


class QueuedLines(QueueHandler):
    """Hands records to the thread that writes them, as far as there is room."""

    def enqueue(self, record: logging.LogRecord) -> None:
        """Hands one record over, or drops it."""
        try:
            self.queue.put_nowait(record)
        except queue.Full:
            return


def start_logging(arm: str) -> Callable[[], None]:
    """Has all log lines written to the standard error, or to the journal if that is what the standard error is.

    Args:
        arm: its name, a field of each line in the journal.

    Returns:
        What writes the lines that wait at the end.
    """
    output, form = sys.stderr.fileno(), logging.Formatter("%(levelname)s %(name)s: %(message)s")
    handler: logging.Handler = LogLines(output)
    end = handler.close
    if stat.S_ISREG(os.fstat(output).st_mode):
        handler = QueuedLines(queue.Queue[logging.LogRecord](MOST_WAITING))
        writing = logging.StreamHandler(sys.stderr)
        writing.setFormatter(form)
        listener, form = QueueListener(handler.queue, writing), logging.Formatter()
        listener.start()
        end = listener.stop
    handler.setFormatter(form)
    if is_journal(output):
        handler = JournalHandler(handler, {"HYPERBIT_ARM": arm})
        end = handler.close
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    for name in ("can", "canopen"):  # each SDO of simulated boards, for one
        logging.getLogger(name).setLevel(logging.WARNING)
    return end
