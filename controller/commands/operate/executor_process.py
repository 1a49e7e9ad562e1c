"""Child processes of `hyperbit run`, above all the executor, for use without a service manager."""

import contextlib
import ctypes
import errno
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from typing import IO

PR_SET_PDEATHSIG = 1  # of linux/prctl.h
INPUT = 0  # file descriptor of the standard input
FOREGROUND_POLL = 0.5  # [s] between two attempts to read a terminal in the background
END_TIMEOUT = 5.0  # [s] for the executor to end by itself


def start_executor(words: Sequence[str], *, simulate: bool, log: IO[bytes] | None = None) -> subprocess.Popen[bytes]:
    """Starts `hyperbit execute` with these words; it ends with this process.

    Its process group is its own: Ctrl-C reaches only this process, which ends goals first. With `simulate` this process
    passes the lines of its standard input on to the child, which reads commands for faults from them. A terminal is not
    passed on to another process group. With `log` the child reads nothing, and its messages go there.
    """
    command = [sys.executable, "-m", "hyperbit", "execute", *words, *["--simulate"] * simulate]
    process = start_child(command, subprocess.PIPE if simulate and log is None else subprocess.DEVNULL, log)
    if process.stdin is not None:
        threading.Thread(target=pass_lines, args=(process.stdin,), name="lines", daemon=True).start()
    return process


def pass_lines(to: IO[bytes]) -> None:
    """Copies the standard input until its end; also after this process comes to the foreground of its terminal."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTIN})  # a read in the background fails, and stops no process
    with contextlib.suppress(OSError), to:
        while True:
            try:
                data = os.read(INPUT, 4096)
            except OSError as error:
                if error.errno != errno.EIO or not os.isatty(INPUT):
                    return
                time.sleep(FOREGROUND_POLL)
                continue
            if not data:
                return
            to.write(data)
            to.flush()


def start_child(
    command: Sequence[str], stdin: int | None = None, log: IO[bytes] | None = None
) -> subprocess.Popen[bytes]:
    """Starts a program in a process group of its own; the kernel ends it with this process.

    In a session of its own Linux 6.18 would not schedule it for seconds on a busy machine.
    """
    parent, prctl = os.getpid(), ctypes.CDLL(None).prctl  # looked up before the fork

    def die_with_parent() -> None:
        prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:  # the parent was killed meanwhile
            os._exit(1)

    private = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")  # of systemd: only this process notifies it
    own = {name: value for name, value in os.environ.items() if name not in private}
    return subprocess.Popen(command, preexec_fn=die_with_parent, process_group=0, stdin=stdin, stderr=log, env=own)


def end_child(process: subprocess.Popen[bytes], timeout: float = END_TIMEOUT) -> None:
    """Ends a program; kills it after `timeout` seconds."""
    process.terminate()
    try:
        process.wait(timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
