"""The signals that end a process in order: SIGTERM, SIGINT, and SIGHUP, which a terminal sends when it is closed.

SIGHUP stays ignored if it was ignored at the start, as `nohup` does.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import FrameType

ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
AGAIN = 0.05  # [s] after which SystemExit is raised again
OF_TERMINAL = (signal.SIGINT, signal.SIGHUP)  # a terminal sends them to all its processes


class Ending:
    """Whether the process is to end.

    The handler of a signal may call `set` at any moment. `threading.Event.set` would wait for a lock there, which the
    interrupted `wait` may hold: the process would never end.
    """

    def __init__(self) -> None:
        self._woken = os.eventfd(0, os.EFD_NONBLOCK)
        self._set = False

    def set(self) -> None:
        self._set = True
        os.eventfd_write(self._woken, 1)

    def is_set(self) -> bool:
        return self._set

    def wait(self, seconds: float | None = None) -> bool:
        """Waits for the end, at most `seconds`; returns whether it has come."""
        if not self._set:
            select.select([self._woken], [], [], seconds)
        return self._set


def end_on_signals(end: Callable[[], object]) -> None:
    """Makes each signal that ends the process call `end` in the main thread.

    A SIGHUP that follows another signal is ignored: kernel, shell and service manager each send one.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        end()

    for number in (signal.SIGTERM, signal.SIGINT, *hang_up()):
        signal.signal(number, handle)


def exit_on_signals() -> None:
    """Makes SIGTERM and SIGHUP raise SystemExit, so that the command closes its resources. Python does this at SIGINT.

    The exit code is that of a shell, 128 plus the signal's number. A C callback drops every exception, such as one of
    LLVM while kernels are loaded; then SystemExit is raised again soon after it.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        ignore((signal.SIGTERM, *hang_up()))  # a second signal must not interrupt the end
        signal.signal(signal.SIGALRM, lambda *_: sys.exit(128 + number))
        sys.unraisablehook = receive_dropped
        sys.exit(128 + number)

    def receive_dropped(dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, SystemExit):
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        else:
            sys.__unraisablehook__(dropped)

    for number in (signal.SIGTERM, *hang_up()):
        signal.signal(number, handle)


def ignore(numbers: Iterable[signal.Signals]) -> None:
    """Ignores signals from now on, also in later child processes."""
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)


def hang_up() -> tuple[signal.Signals, ...]:
    return () if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (signal.SIGHUP,)
