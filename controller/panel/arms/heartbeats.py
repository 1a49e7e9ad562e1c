"""Numbered heartbeats to an open page. A command names the latest one: the server then knows how old the command is."""

import itertools
import time
from collections.abc import Callable

PERIOD = 0.25  # [s], longest time between two heartbeats
LONGEST = 2.0  # [s], greatest age of the heartbeat that a command names
KEPT = 1000  # heartbeats of a page whose times are known

_numbers = itertools.count(1)  # unique among all pages


class Heartbeats:
    """The heartbeats of one page. Each has the time at which it was sent, by the server's clock alone."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._sent: dict[int, float] = {}

    def next(self) -> int:
        """Returns the number of a heartbeat to send now."""
        number = next(_numbers)
        self._sent[number] = self._clock()
        while len(self._sent) > KEPT:
            del self._sent[next(iter(self._sent))]
        return number

    def refusal(self, number: int | None) -> str | None:
        """Returns why a command that names this heartbeat is too late, or None. Thread-safe."""
        if number is None:
            return (
                "the command names no heartbeat of the server, so its age is unknown: reload the page, then press again"
            )
        sent = self._sent.get(number)
        if sent is not None and self._clock() - sent <= LONGEST:
            return None
        age = "of unknown age" if sent is None else f"{self._clock() - sent:.1f} s old"
        return (
            f"the command came too late: it names a heartbeat that is {age}, and may be {LONGEST:g} s old."
            " Network or server stood still. Nothing was sent to the arm: look at the arm, then press again"
        )
