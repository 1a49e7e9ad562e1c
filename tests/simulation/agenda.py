"""Time in the simulated world: events in the order of their times, and of their entry where times are equal."""

from __future__ import annotations

import heapq
from collections.abc import Callable


class Agenda:
    """What is to happen.

    Attributes:
        now: time [s].
        steps: events so far.
    """

    def __init__(self) -> None:
        self.now = 1000.0
        self.steps = 0
        self._entries: list[tuple[float, int, Callable[[], None]]] = []
        self._number = 0

    def after(self, delay: float, happen: Callable[[], None]) -> None:
        """Has something happen after a delay [s]."""
        self.at(self.now + delay, happen)

    def at(self, time: float, happen: Callable[[], None]) -> None:
        """Has something happen at a time, or now if the time has passed [s]."""
        self._number += 1
        heapq.heappush(self._entries, (max(time, self.now), self._number, happen))

    def step(self) -> None:
        """Lets the next event happen."""
        self.now, _, happen = heapq.heappop(self._entries)
        self.steps += 1
        happen()
