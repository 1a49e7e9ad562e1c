"""The order in which requests and setpoints came, which decides what a cancel, stop or reset still ends."""

import itertools
import threading
from collections.abc import Callable

import zenoh

Receive = Callable[[], zenoh.Sample | None]


class Arrivals:
    """Numbers requests and setpoints by their arrival; from any thread.

    Requests are numbered as they come. Of setpoints, which may come faster than anybody reads, only the latest waits to
    be read; before a request is numbered, one that waits is, so that it counts as earlier.

    Args:
        receive: returns the latest setpoint, None if there is none; must not wait.
    """

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._waiting: tuple[zenoh.Sample, int] | None = None

    def request(self) -> int:
        """Returns the place of a request that comes now."""
        with self._lock:
            self._number()
            return next(self._numbers)

    def setpoint(self) -> tuple[zenoh.Sample, int] | None:
        """Returns the latest setpoint, and the place of the first that came since the last call; None if none did."""
        with self._lock:
            self._number()
            waiting, self._waiting = self._waiting, None
            return waiting

    def _number(self) -> None:
        if (sample := self._receive()) is not None:
            self._waiting = sample, self._waiting[1] if self._waiting else next(self._numbers)
