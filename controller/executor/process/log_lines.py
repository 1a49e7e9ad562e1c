"""Log lines on the standard error, written by the event loop's thread. A reader that hangs must not stop the loop.

A second thread would take the interpreter's lock at times. Without a real-time priority it could not run while other
processes are busy, and the event loop would wait for it. A thread writes only if the standard error is a file, since a
write to a disk can take a tenth of a second.
"""

import contextlib
import logging
import os
import queue
import select
import stat
import sys
from collections import deque
from collections.abc import Callable
from logging.handlers import QueueHandler, QueueListener

from hyperbit.controller.host.journal import JournalHandler, is_journal

MOST_WAITING = 1_000  # log lines; more are dropped
MOST_WRITTEN = 4_096  # bytes in one write; a writable pipe accepts them without blocking
LAST_LINES_TIMEOUT = 0.5  # [s] for the waiting lines at the end


class LogLines(logging.Handler):
    """Writes each line at once if the file descriptor accepts it, otherwise with a later line."""

    def __init__(self, output: int) -> None:
        super().__init__()
        self._output, self._waiting = output, deque[bytes]()

    def emit(self, record: logging.LogRecord) -> None:
        try:
            line = (self.format(record) + "\n").encode(errors="backslashreplace")
        except Exception:  # a message that does not fit its arguments must not stop the arm
            line = f"{record.levelname} {record.name}: a line cannot be written: {record.msg!r}\n".encode()
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append(line)
        self._write(0.0)

    def close(self) -> None:
        self._write(LAST_LINES_TIMEOUT)
        super().close()

    def _write(self, timeout: float) -> None:
        """Writes while the output accepts lines; waits for `timeout` before each write [s]."""
        try:
            while self._waiting and select.select([], [self._output], [], timeout)[1]:
                line = self._waiting.popleft()
                written = os.write(self._output, line[:MOST_WRITTEN])
                if written < len(line):
                    self._waiting.appendleft(line[written:])
        except (OSError, ValueError):  # the reader has gone
            self._waiting.clear()


class QueuedLines(QueueHandler):
    """Queues records for the thread that writes them; drops them if the queue is full."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def start_logging(arm: str) -> Callable[[], None]:
    """Sends all log lines to the standard error, or to systemd's journal if the standard error is connected to it.

    The arm's name is a field of each line in the journal. Returns a function that writes the waiting lines at the end.
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
    for name in ("can", "canopen"):  # they log each SDO of simulated boards
        logging.getLogger(name).setLevel(logging.WARNING)
    return end
