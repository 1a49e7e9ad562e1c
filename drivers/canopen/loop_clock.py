"""A clock that stands still while the loop stalls, for time-outs."""

from __future__ import annotations

_LONGEST_STEP = 0.05  # [s]


class LoopClock:
    """Time for time-outs.

    What arrives during a stall of the loop is taken only afterwards, so a stall alone must end no time-out. Between two
    ticks this clock advances by at most 50 ms.

    Attributes:
        now: the time as of the last tick [s].
        ticked: real time of the last tick [s]; None before the first.
    """

    def __init__(self) -> None:
        self.now = 0.0
        self.ticked: float | None = None

    def at(self, clock: float) -> float:
        """Returns the time at a real time [s]."""
        if self.ticked is None:
            return self.now
        return self.now + min(max(clock - self.ticked, 0.0), _LONGEST_STEP)

    def tick(self, clock: float) -> float:
        """Notes a tick at a real time; returns the time [s]."""
        self.now = self.at(clock)
        self.ticked = clock
        return self.now
