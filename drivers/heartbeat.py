"""The master's heartbeat: boards that miss it hold, or contract."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers import cia301
from drivers.bus import CanBus
from drivers.cia301 import State
from drivers.faults import BusBusy
from drivers.wiring import MASTER, Timing


class Heartbeat:
    """Sends the master's heartbeat on all buses, and tells when the boards were without it.

    Args:
        buses: by name.
        timing: how often, and for how long boards do without.
    """

    def __init__(self, buses: Mapping[str, CanBus], timing: Timing) -> None:
        self._buses, self._timing = buses, timing
        self._last: float | None = None  # when it was looked whether one is due
        self._sent: dict[str, float] = {}

    def tick(self, now: float) -> float:
        """Sends what is due at `now`; returns the time since the last call, 0 at the first [s]."""
        elapsed = 0.0 if self._last is None else now - self._last
        self._last = now
        for bus in self._buses.values():
            self._beat(bus, now)
        return elapsed

    def halted(self, now: float) -> float | None:
        """Returns the time since the last `tick` [s] if boards have been without their master meanwhile, else None."""
        timing, last = self._timing, self._last
        if last is None or now - last < timing.heartbeat_timeout - timing.heartbeat:
            return None
        armed = [name for name, bus in self._buses.items() if bus.armed]
        without = any(now - self._sent.get(name, now) >= timing.heartbeat_timeout for name in armed)
        return now - last if without else None

    def _beat(self, bus: CanBus, now: float) -> None:
        due = now >= self._sent.get(bus.name, -math.inf) + self._timing.heartbeat
        if not bus.usable or not (due or bus.failing):  # one more tells whether it still fails
            return
        try:
            bus.send(cia301.heartbeat(MASTER, State.OPERATIONAL))
        except BusBusy:
            return  # counted by the bus, and tried again with the next tick
        self._sent[bus.name] = now
