"""Standard output and error that never wait for their readers.

A paused terminal (Ctrl-S), a pipe that nobody reads and a disk that hangs take no data, and a daemon must go on. Data
waits in memory meanwhile; beyond MOST_WAITING it is dropped, and a line gives the number when the reader returns.

The thread that prints also writes. A second thread would take the interpreter's lock from a real-time loop at times.
Without a real-time priority it could not run while other processes are busy. A thread writes only to files, since a
disk can take a tenth of a second, and to terminals of other users, which cannot be opened again.
"""

import atexit
import contextlib
import io
import logging
import os
import re
import signal
import socket
import stat
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue

MOST_WAITING = 1 << 20  # bytes
LAST_TIMEOUT = 0.5  # [s] for the waiting data at the end of the process
POLL = 0.01  # [s] between two attempts at the end
# A line of Zenoh's log, with colours: time, level, thread, module, text.
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
ZENOH_LINE = re.compile(r"\S+Z +(ERROR|WARN|INFO|DEBUG|TRACE) +(?:\S+ +)?ThreadId\(\d+\) (\S+): (.*)")

Send = Callable[[bytes], int]  # returns how many bytes the reader has taken; BlockingIOError: none now


class Backlog:
    """Messages that wait for a reader. `notice` makes the message that gives the number of dropped ones.

    Any thread may put; each message is sent once. A signal handler or finalizer may print inside `flush`.
    """

    def __init__(self, send: Send, notice: Callable[[int], bytes]) -> None:
        self._send, self._notice = send, notice
        self._waiting = deque[bytes]()
        self._put = self._sent = self._dropped = 0  # bytes, bytes, messages
        self._putting, self._sending, self._flushing = threading.RLock(), threading.RLock(), False

    @property
    def waits(self) -> bool:
        return bool(self._waiting)

    def put(self, message: bytes) -> None:
        with self._putting:
            fits = self._put - self._sent + len(message) <= MOST_WAITING
            if fits:
                self._tell_dropped()
                self._append(message)
            else:
                self._dropped += 1

    def flush(self) -> bool:
        """Sends what the reader takes. Returns False if there is no reader: then no message waits."""
        with self._sending:
            if self._flushing:  # by this thread, which a signal has interrupted
                return True
            self._flushing = True
            try:
                while self._waiting:
                    self._send_first()
            except BlockingIOError:
                return True
            except OSError:
                while self._waiting:
                    self._sent += len(self._waiting.popleft())
                return False
            finally:
                self._flushing = False
            return True

    def finish(self) -> None:
        """Waits until the reader has taken all messages, at most LAST_TIMEOUT."""
        until = time.monotonic() + LAST_TIMEOUT
        while self.flush() and self._waiting and time.monotonic() < until:
            time.sleep(POLL)

    def _send_first(self) -> None:
        first = self._waiting[0]
        taken = self._send(first)
        self._sent += taken
        if taken < len(first):
            self._waiting[0] = first[taken:]
            return
        self._waiting.popleft()
        if not self._waiting:
            with self._putting:
                self._tell_dropped()

    def _tell_dropped(self) -> None:
        count, self._dropped = self._dropped, 0
        if count:
            self._append(self._notice(count))

    def _append(self, message: bytes) -> None:
        self._put += len(message)
        self._waiting.append(message)


def dropped_line(count: int) -> bytes:
    return b"WARNING output: %d lines were dropped: nobody read them\n" % count


class Output(io.RawIOBase):
    """A file descriptor to which each write returns at once."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self._number, send = number, prompt_send(number)
        self._send = send or partial(os.write, os.dup(number))
        self._backlog = Backlog(self._send, dropped_line)
        self._turns, self._ended = SimpleQueue[bool](), False  # False ends the thread
        self._thread = None if send is not None else threading.Thread(target=self._write_all, daemon=True)
        if self._thread is not None:
            self._thread.start()

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._number

    def isatty(self) -> bool:
        return os.isatty(self._number)

    def write(self, data: bytes, /) -> int:  # type: ignore[override]  # of a text stream, which gives bytes
        if self._ended:
            with contextlib.suppress(OSError):
                self._send(bytes(data))
        else:
            self._backlog.put(bytes(data))
            self.flush()
        return len(data)

    def flush(self) -> None:
        if self._ended:
            return
        if self._thread is None:
            self._backlog.flush()
        elif self._backlog.waits and self._turns.empty():
            self._turns.put(True)

    def finish(self) -> None:
        """Waits a moment for the reader. Afterwards no lock is taken: a thread that has it may be gone."""
        if self._thread is None:
            self._backlog.finish()
        else:
            self._turns.put(False)
            self._thread.join(LAST_TIMEOUT)
            if self._thread.is_alive():
                self._send = len  # what follows is dropped
        self._ended = True

    def _write_all(self) -> None:
        while self._turns.get():
            self._backlog.flush()
        self._backlog.flush()


def prompt_send(number: int) -> Send | None:
    """Returns a function that writes to a descriptor and never waits; None if the descriptor has no such way.

    The open file of a descriptor is shared with other processes, which would not expect it to refuse data. So pipes and
    terminals are opened again. `select` cannot replace that: a writable terminal may still wait in the write.
    """
    mode = os.fstat(number).st_mode
    if stat.S_ISSOCK(mode):
        own = socket.socket(fileno=os.dup(number))
        return lambda data: own.send(data, socket.MSG_DONTWAIT)
    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
        with contextlib.suppress(OSError):  # it belongs to another user, or nobody reads it
            flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
            return partial(os.write, os.open(f"/proc/self/fd/{number}", flags))
    return None


def never_wait() -> None:
    """Makes all that this process prints wait for no reader. A stream that a test captures stays as it is."""
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # `stty tostop` would stop a process in the background
    for number, name in (1, "stdout"), (2, "stderr"):
        stream = getattr(sys, name)
        try:
            replaceable = stream.fileno() == number and not isinstance(stream.buffer, Output)
        except (OSError, AttributeError):
            replaceable = False
        if replaceable:
            stream.flush()
            output = Output(number)
            form = {"encoding": stream.encoding, "errors": "backslashreplace", "line_buffering": True}
            setattr(sys, name, io.TextIOWrapper(output, **form))
            atexit.register(output.finish)


def flush_outputs() -> None:
    """Sends what has waited for a reader, and does not wait. Call it now and then."""
    for stream in (sys.stdout, sys.stderr, *logging.root.handlers):
        stream.flush()


def relay_zenoh_log() -> None:
    """Passes Zenoh's own log, which waits for the reader of the standard output, to the log of this process.

    Call it after `never_wait`.
    """
    if not isinstance(getattr(sys.stdout, "buffer", None), Output):  # captured
        return
    reading, writing = os.pipe2(os.O_CLOEXEC)
    os.dup2(writing, 1)
    os.close(writing)

    def relay() -> None:
        with os.fdopen(reading, errors="replace") as lines:
            for line in lines:
                text = COLOUR.sub("", line).strip()
                found = ZENOH_LINE.fullmatch(text)
                level, name, text = found.groups() if found else ("ERROR", "zenoh", text)
                logging.getLogger(name).log(getattr(logging, level.replace("TRACE", "DEBUG")), "%s", text)

    threading.Thread(target=relay, name="zenoh's log", daemon=True).start()
