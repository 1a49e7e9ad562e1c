"""Whether the actuators did what they were told, as their end-stops see it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.faults import Fault
from drivers.wiring import Timing, Wiring

_WORDS = ("contracted", "extended")


class Watch:
    """Commanded against measured states of all A actuators."""

    def __init__(self, wiring: Wiring, timing: Timing) -> None:
        self._places = [channel.place for channel in wiring.channels]
        self._timing = timing
        self._sensed = np.array([c.input is not None for c in wiring.channels], dtype=np.bool_)
        self.reset(np.full(self._sensed.size, -1, dtype=np.int8))

    def reset(self, states: NDArray[np.int8]) -> None:
        """Forgets motions and what was reported; the (A,) `states` are right from now on, -1 unknown."""
        self._commanded = states.copy()
        self._switched_at = np.zeros(states.size)
        self._pending = np.zeros(states.size, dtype=np.bool_)
        self._confirms = np.zeros(states.size, dtype=np.bool_)
        self._reported = np.zeros(states.size, dtype=np.bool_)
        self._ask_at = np.zeros(states.size)

    def accept(self, measured: NDArray[np.int8]) -> None:
        """Takes what is measured, (A,), as right; actuators on their way stay so, they cannot stop between the ends."""
        self._commanded = np.where(self._pending, self._commanded, measured).astype(np.int8)

    def switched(
        self, which: NDArray[np.bool_], states: NDArray[np.uint8], measured: NDArray[np.int8], now: float
    ) -> None:
        """Notes which of the actuators, (A,), were switched to their `states`, (A,), at `now` [s]."""
        self._commanded[which] = states[which]
        self._switched_at[which] = now
        self._pending |= which
        self._ask_at[which] = now + self._timing.travel_time
        # An actuator called back halfway never left its end-stop's last word: only time tells when it is there.
        self._confirms[which] = (self._sensed & (measured != self._commanded))[which]

    def moving(self, measured: NDArray[np.int8], now: float) -> bool:
        """Whether a switched actuator is still on its way, by its end-stop or else by the travel time."""
        travels = now - self._switched_at < self._timing.travel_time
        on_way = np.where(self._confirms, measured != self._commanded, travels)
        return bool(np.any(self._pending & on_way))

    def overdue(self, measured: NDArray[np.int8], now: float) -> NDArray[np.bool_]:
        """Which actuators, (A,), should have arrived by now and, as `measured`, (A,), have not; each a few times."""
        late: NDArray[np.bool_] = self._pending & self._sensed & (now >= self._ask_at)
        late &= (measured >= 0) & (measured != self._commanded)
        self._ask_at[late] = now + self._timing.settle_margin / 3
        return late

    def check(self, measured: NDArray[np.int8], now: float) -> list[Fault]:
        """Compares commanded with measured states, (A,).

        Args:
            measured: 0/1, -1 unknown.
            now: [s].

        Returns:
            "stuck" for each actuator that did not arrive in time, "unexpected-motion" for each that moved by itself;
            one for an actuator until `reset`.
        """
        due = self._pending & (now - self._switched_at >= self._timing.travel_time + self._timing.settle_margin)
        self._pending &= ~due
        known = self._sensed & (measured >= 0) & (self._commanded >= 0)
        wrong = known & (measured != self._commanded) & ~self._pending & ~self._reported
        self._reported |= wrong
        return [self._fault(int(a), bool(due[a])) for a in np.flatnonzero(wrong)]

    def _fault(self, actuator: int, due: bool) -> Fault:
        place = self._places[actuator]
        should, is_ = _WORDS[self._commanded[actuator]], _WORDS[1 - self._commanded[actuator]]
        if due:
            limit = self._timing.travel_time + self._timing.settle_margin
            text = f"actuator {place} was to be {should} within {limit:g} s; its end-stop still reads {is_}"
            return Fault("stuck", place, text)
        text = f"the end-stop of actuator {place} reads {is_}, and it was not commanded: it should be {should}"
        return Fault("unexpected-motion", place, text)
