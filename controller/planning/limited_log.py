"""A log of what may come thousands of times a second: few lines, and a count of the others."""

import logging
import threading
import time
from collections.abc import Callable

MOST = 5  # lines in one second


class LimitedLog:
    """Logs at most MOST lines in a second; the first line after that says how many were left out. For any thread.

    Args:
        log: to write to.
        clock: [s].
    """

    def __init__(self, log: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._clock, self._lock = log, clock, threading.Lock()
        self._since, self._written, self._left_out = -float("inf"), 0, 0

    def info(self, text: str, *arguments: object) -> None:
        """Logs a line, or counts it."""
        with self._lock:
            now = self._clock()
            if now - self._since >= 1.0:
                self._since, self._written = now, 0
            if self._written >= MOST:
                self._left_out += 1
                return
            self._written += 1
            left_out, self._left_out = self._left_out, 0
        self._log.info(text, *arguments)
        if left_out:
            self._log.info("%d lines like this were left out before", left_out)
