"""A simulated two-state actuator: a valve with one or two coils, a piston, and an end-stop switch at each end."""

from __future__ import annotations

import math
from collections.abc import Callable

CONTRACTED, EXTENDED = 0, 1

_OPENS = 0.05  # fraction of the stroke after which the switch of the old end opens
_NEAR = 1e-9  # [s], or fraction of the stroke, that counts as zero


class Actuator:
    """Moves at a constant speed between its ends, 0 contracted and 1 extended.

    With one coil, a spring returns the actuator to its rest end while the coil or the supply is off. With two coils,
    the valve stays as it is without energy: the coil `on` switches it to extended, the coil `off` to contracted. The
    valve does not switch while both coils are energised.

    An end-stop switch closes when the actuator arrives at its end. It opens when the actuator has moved 5 % of the
    stroke away from that end. In mid-stroke both switches are open.

    Args:
        travel_time: from end to end [s].
        contract_time: from extended to contracted [s]; None: `travel_time`.
        least_pulse: shortest pulse of one of two coils that switches the valve [s]; None: one coil.
        rest: end to which the spring returns the actuator.
        inverted: whether the switches at the contracted and the extended end read 0 while closed.
    """

    def __init__(
        self,
        label: str,
        travel_time: float,
        contract_time: float | None = None,
        *,
        least_pulse: float | None = None,
        rest: int = CONTRACTED,
        inverted: tuple[bool, bool] = (False, False),
    ) -> None:
        self.label = label
        self.position = float(rest)  # 0..1
        self.driven = rest  # end to which the valve drives the actuator
        self.switches = 0  # number of switches of the valve
        self.coils = (0, 0)  # whether `on` and `off` are energised
        self.both_on = 0  # number of times when both coils were energised
        self.longest_pulse = 0.0  # of one of two coils [s]
        self.observers: list[Callable[[], None]] = []  # called after a switch has opened or closed
        self._times = (travel_time if contract_time is None else contract_time, travel_time)
        self._two_coils = least_pulse is not None
        self._least_pulse = least_pulse or 0.0
        self._rest = rest
        self._inverted = inverted
        self._closed = [rest == CONTRACTED, rest == EXTENDED]
        self._slowness = 1.0
        self._stuck: int | None = None
        self._jam: float | None = None
        self._wire: int | tuple[int, int] | None = None  # level of both wires, or the frozen readings of the switches
        self._energised_at = 0.0
        self._flips_at = math.inf
        self._now: float | None = None

    def reads(self, end: int) -> int:
        """Returns the level of the switch at an end: 1 while it is closed, or 0 if it is inverted."""
        if isinstance(self._wire, tuple):
            return self._wire[end]
        return self._closed[end] ^ self._inverted[end] if self._wire is None else self._wire

    @property
    def due(self) -> float:
        """Time of the next change of valve, switch or arrival [s]; infinity if there is none."""
        target = self._target
        way = abs(target - self.position)
        if self._now is None or way == 0.0:
            return self._flips_at
        time = self._time(target)
        next_ = self._now + way * time
        for end in (CONTRACTED, EXTENDED):
            rest = _OPENS - abs(self.position - end)  # share of the stroke until the switch opens
            if self._closed[end] and 0.0 < rest < way and abs(target - end) > abs(self.position - end):
                next_ = min(next_, self._now + rest * time)
        return min(next_, self._flips_at)

    def drive(self, on: int, now: float, off: int = 0) -> None:
        self.step(now)
        if (on, off) == self.coils:
            return
        if self._two_coils and 1 in self.coils:
            self.longest_pulse = max(self.longest_pulse, now - self._energised_at)
        self.both_on += on and off
        self.coils, self._energised_at = (on, off), now
        if not self._two_coils:
            self._switch(self._rest ^ on)
        elif on != off and on != self.driven:
            self._flips_at = now + self._least_pulse
            self.step(now)
        else:
            self._flips_at = math.inf

    def step(self, now: float) -> None:
        if self._flips_at <= now + _NEAR:
            self._advance(self._flips_at)
            self._flips_at = math.inf
            self._switch(self.coils[0])
        self._advance(now)

    def position_at(self, now: float) -> float:
        """Returns the position at a time between the last step and `due` [s]."""
        target = self._target
        way = target - self.position
        if way == 0.0 or self._now is None:
            return self.position
        elapsed, time = now - self._now, self._time(target)
        return target if abs(way) * time <= elapsed + _NEAR else self.position + math.copysign(elapsed / time, way)

    # --- faults, and their ends

    def stick(self, state: int) -> None:
        """Makes the actuator go to an end and stay there, whatever the valve does."""
        self._stuck = state

    def jam(self, position: float | None = None) -> None:
        """Blocks the actuator when it arrives at a position; None: at its present position."""
        self._jam = self.position if position is None else position

    def release(self) -> None:
        self._stuck = self._jam = None

    def slow(self, factor: float) -> None:
        """Multiplies the travel times by a factor; 1 is normal."""
        self._slowness = factor

    def lose_sensor(self) -> None:
        """Freezes the readings of the end-stop switches."""
        self._wire = self.reads(CONTRACTED), self.reads(EXTENDED)

    def short_wires(self) -> None:
        """Makes both end-stop switches read 1."""
        self._wire = 1

    def cut_wires(self) -> None:
        """Makes both end-stop switches read 0."""
        self._wire = 0

    def restore_sensor(self) -> None:
        self._wire = None

    @property
    def _target(self) -> float:
        """An end, or the position at which the actuator is blocked."""
        end = self.driven if self._stuck is None else self._stuck
        if self._jam is None:
            return float(end)
        low, high = sorted((self.position, float(end)))
        return self._jam if low <= self._jam <= high or abs(self.position - self._jam) < _NEAR else float(end)

    def _time(self, target: float) -> float:
        """Returns the travel time from end to end towards the target [s]."""
        return self._times[target > self.position] * self._slowness

    def _switch(self, end: int) -> None:
        self.switches += end != self.driven
        self.driven = end

    def _advance(self, now: float) -> None:
        self.position = self.position_at(now)
        self._now = now
        before = tuple(self._closed)
        for end in (CONTRACTED, EXTENDED):
            if self.position == end:
                self._closed[end] = True
            elif abs(self.position - end) >= _OPENS - _NEAR:
                self._closed[end] = False
        if tuple(self._closed) != before:
            for observe in self.observers:
                observe()
