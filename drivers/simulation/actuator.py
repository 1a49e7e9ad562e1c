"""A simulated two-state actuator: a valve with one coil or two, a piston that it moves, and an end-stop at each end."""

from __future__ import annotations

import math

CONTRACTED, EXTENDED = 0, 1

_OPENS = 0.05  # share of the stroke after which the switch of the end that was left opens
_NEAR = 1e-9  # [s], and share of the stroke, that count as none


class Actuator:
    """Moves at a constant speed between its ends, 0 contracted and 1 extended.

    With one coil, a spring returns it to its rest end when the coil, or the supply, is off. With two coils its valve
    stays as it is without energy: the coil `on` switches it to extended, the coil `off` to contracted. While both coils
    are energised the valve stays as it was, and both heat.

    An end-stop switch closes when the actuator arrives at its end, and opens when the actuator has left that end by 5 %
    of the stroke. In mid-stroke both switches are open.

    Args:
        label: as in the wiring.
        travel_time: from end to end [s].
        contract_time: from extended to contracted [s]; None: `travel_time`.
        coils: 1 or 2.
        least_pulse: time that a coil of two must be energised to switch the valve [s].
        rest: end to which the spring of one coil goes.
        inverted: whether the wires of the switches at the contracted and the extended end read 0 while closed.

    Attributes:
        position: 0..1.
        driven: end that the valve drives it to.
        switches: how often the valve switched.
        coils: which coils are energised: on, off.
        both_on: how often both coils came to be energised at once.
        longest_pulse: longest time that a coil of two was energised [s].
    """

    def __init__(
        self,
        label: str,
        travel_time: float,
        contract_time: float | None = None,
        *,
        coils: int = 1,
        least_pulse: float = 0.0,
        rest: int = CONTRACTED,
        inverted: tuple[bool, bool] = (False, False),
    ) -> None:
        self.label = label
        self.position = float(rest)
        self.driven = rest
        self.switches = 0
        self.coils = (0, 0)
        self.both_on = 0
        self.longest_pulse = 0.0
        self._times = (travel_time if contract_time is None else contract_time, travel_time)
        self._two_coils = coils == 2
        self._least_pulse = least_pulse
        self._rest = rest
        self._inverted = inverted
        self._closed = [rest == CONTRACTED, rest == EXTENDED]
        self._slowness = 1.0
        self._stuck: int | None = None
        self._jam: float | None = None
        self._wire: int | tuple[int, int] | None = None  # a level of both wires, or what the switches read for good
        self._energised_at = 0.0
        self._flips_at = math.inf
        self._now: float | None = None

    def reads(self, end: int) -> int:
        """The level on the wire of the switch at an end: 1 while the switch is closed, or 0 if it is inverted."""
        if isinstance(self._wire, tuple):
            return self._wire[end]
        return self._closed[end] ^ self._inverted[end] if self._wire is None else self._wire

    @property
    def due(self) -> float:
        """When its valve switches, a switch opens, or it arrives [s]; infinity if nothing of it is under way."""
        target = self._target
        way = abs(target - self.position)
        if self._now is None or way == 0.0:
            return self._flips_at
        time = self._time(target)
        next_ = self._now + way * time
        for end in (CONTRACTED, EXTENDED):
            left = _OPENS - abs(self.position - end)
            if self._closed[end] and 0.0 < left < way and abs(target - end) > abs(self.position - end):
                next_ = min(next_, self._now + left * time)
        return min(next_, self._flips_at)

    def drive(self, on: int, now: float, off: int = 0) -> None:
        """Energises its coils, 1, or not, 0."""
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
        """Moves it on to the time `now` [s]."""
        if self._flips_at <= now + _NEAR:
            self._advance(self._flips_at)
            self._flips_at = math.inf
            self._switch(self.coils[0])
        self._advance(now)

    def position_at(self, now: float) -> float:
        """Returns where it is at a time between the last step and `due` [s]."""
        target = self._target
        way = target - self.position
        if way == 0.0 or self._now is None:
            return self.position
        elapsed, time = now - self._now, self._time(target)
        return target if abs(way) * time <= elapsed + _NEAR else self.position + math.copysign(elapsed / time, way)

    # --- faults, and their ends

    def stick(self, state: int) -> None:
        """Lets it go to an end and stay there, whatever its valve does."""
        self._stuck = state

    def jam(self, position: float | None = None) -> None:
        """Holds it at a position as soon as it comes there; where it is now if None."""
        self._jam = self.position if position is None else position

    def release(self) -> None:
        """Lets it follow its valve again."""
        self._stuck = self._jam = None

    def slow(self, factor: float) -> None:
        """Makes its travel longer by a factor; 1 is as built."""
        self._slowness = factor

    def lose_sensor(self) -> None:
        """Freezes what the end-stop switches read."""
        self._wire = self.reads(CONTRACTED), self.reads(EXTENDED)

    def short_wires(self) -> None:
        """Lets the wires of both end-stop switches read 1."""
        self._wire = 1

    def cut_wires(self) -> None:
        """Lets the wires of both end-stop switches read 0."""
        self._wire = 0

    def restore_sensor(self) -> None:
        """Lets the end-stop switches read again."""
        self._wire = None

    @property
    def _target(self) -> float:
        """Where it is going: an end, or the position at which it is held."""
        end = self.driven if self._stuck is None else self._stuck
        if self._jam is None:
            return float(end)
        low, high = sorted((self.position, float(end)))
        return self._jam if low <= self._jam <= high or abs(self.position - self._jam) < _NEAR else float(end)

    def _time(self, target: float) -> float:
        """From end to end in the direction of the target [s]."""
        return self._times[target > self.position] * self._slowness

    def _switch(self, end: int) -> None:
        self.switches += end != self.driven
        self.driven = end

    def _advance(self, now: float) -> None:
        self.position = self.position_at(now)
        self._now = now
        for end in (CONTRACTED, EXTENDED):
            if self.position == end:
                self._closed[end] = True
            elif abs(self.position - end) >= _OPENS - _NEAR:
                self._closed[end] = False
