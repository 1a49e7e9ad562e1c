"""Time in the simulated world: events in the order of their times; equal times keep the order of entry."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable


class StepsAreOver(BaseException):
    """A world has run all its steps. Nothing between the world and its agenda may catch it."""


class Agenda:
    """The queue of future events.

    Attributes:
        now: time [s].
        steps: number of events so far.
        end: number of events after which the next one raises `StepsAreOver`.
    """

    def __init__(self) -> None:
        self.now = 1000.0
        self.steps = 0
        self.end = math.inf
        self._entries: list[tuple[float, int, Callable[[], object]]] = []
        self._number = 0

    def after(self, delay: float, happen: Callable[[], object]) -> None:
        """Schedules an event after a delay [s]."""
        self.at(self.now + delay, happen)

    def at(self, time: float, happen: Callable[[], object]) -> None:
        """Schedules an event at a time, or now if the time has passed [s]."""
        self._number += 1
        heapq.heappush(self._entries, (max(time, self.now), self._number, happen))

    def clear(self) -> None:
        self._entries.clear()

    def run(self, seconds: float) -> None:
        """Runs all events of a time [s]."""
        end = self.now + seconds
        while self._entries and self._entries[0][0] <= end:
            self.step()
        self.now = end

    def until(self, holds: Callable[[], object], longest: float = 20.0) -> float:
        """Runs events until something holds; returns the time taken [s]."""
        begun = self.now
        while not holds():
            assert self.now - begun < longest, f"waited {longest:g} s in vain"
            self.step()
        return self.now - begun

    def step(self) -> None:
        if self.steps >= self.end:
            raise StepsAreOver
        self.now, _, happen = heapq.heappop(self._entries)
        self.steps += 1
        happen()
