"""Real time: SCHED_FIFO and locked memory, and log lines that never wait.

The service's unit gives the priority, or the arm's file requests it. The event loop's thread writes the log lines on
the standard error: a reader that hangs must not stop the loop. A second thread would take the interpreter's lock at
times. Without a real-time priority it could not run while other processes are busy, and the event loop would wait for
it. A thread writes only if the standard error is a file, since a write to a disk can take a tenth of a second.
"""

import contextlib
import ctypes
import logging
import os
import queue
import resource
import select
import stat
import sys
from collections import deque
from collections.abc import Callable
from logging.handlers import QueueHandler, QueueListener
from pathlib import Path

from hyperbit.controller.armfile.settings import RealTimeSettings
from hyperbit.controller.host.journal import JournalHandler, is_journal
from hyperbit.controller.host.scheduling import shorten_slice

log = logging.getLogger(__name__)

MOST_WAITING = 1_000  # log lines; more are dropped
MOST_WRITTEN = 4_096  # bytes in one write; a writable pipe accepts them without blocking
LAST_LINES_TIMEOUT = 0.5  # [s] for the waiting lines at the end
# From asm-generic/mman.h. With ONFAULT, pages that were never touched take no memory.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
CAP_IPC_LOCK = 14  # from linux/capability.h


def enter_real_time(settings: RealTimeSettings | None) -> str:
    """Gives the process a priority of SCHED_FIFO, unless it has one, and locks its memory.

    Without permission the executor continues: motions are as safe, but the loop's period varies more. Without settings
    the unit alone decides. Returns "off", "on", or a sentence on what is missing.
    """
    given = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
    if settings is None and not given:
        shorten_slice()
        return "off"
    words = [None if given or settings is None else raise_priority(settings.priority), lock_memory()]
    missing = [word for word in words if word]
    for word in missing:
        log.warning("real time: %s; continuing without it", word)
    return "; ".join(missing) or "on"


def raise_priority(priority: int) -> str | None:
    """Gives the process a priority of SCHED_FIFO, which children do not inherit; returns what is missing, or None."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return (
            f"SCHED_FIFO with priority {priority} is not permitted: CPUSchedulingPolicy=fifo in the unit is needed,"
            " or CAP_SYS_NICE"
        )
    return None


def lock_memory() -> str | None:
    """Locks the memory of the process against paging; returns what is missing, or None."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and not may_lock_all():  # an allocation would fail in the middle of a motion
        return f"memory can be locked up to {limit} bytes only: LimitMEMLOCK=infinity in the unit is needed"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        return f"memory cannot be locked: {os.strerror(ctypes.get_errno())}"
    return None


def may_lock_all() -> bool:
    """Returns whether the process has CAP_IPC_LOCK, which makes it exempt from the limit."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (effective,) = (int(line.split()[1], 16) for line in lines if line.startswith("CapEff"))
    return bool(effective >> CAP_IPC_LOCK & 1)


# --- log lines


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
