"""Counts heartbeats, to find two boards with one node id."""

from __future__ import annotations

_WINDOW = 10  # length of a counting window in heartbeat periods


class BeatCount:
    """Counts the heartbeats of one node id: two boards send twice as many."""

    def __init__(self) -> None:
        self.period = 0.0  # of the heartbeat, as configured [s]; 0 if unknown, or with node guarding
        self.heard = 0
        self._windows = 0
        self._began: float | None = None

    def twice(self, now: float, stalled: bool) -> bool:
        """Returns whether two successive windows of 10 periods had 15 heartbeats or more. Call at each tick.

        Delayed frames arrive together, but only after a window with few of them.
        """
        if not self.period or stalled or self._began is None:
            self._began, self.heard, self._windows = now, 0, 0
        elif now - self._began >= _WINDOW * self.period:
            self._windows = self._windows + 1 if self.heard >= 1.5 * _WINDOW else 0
            self._began, self.heard = now, 0
        return self._windows >= 2
