"""A simulated two-state actuator: a spring towards contracted, a drive towards extended, an end-stop switch."""

from __future__ import annotations


class Actuator:
    """Moves at a constant speed between its ends, 0 contracted and 1 extended.

    Without drive, and so without power, its spring contracts it. Its end-stop switch remembers: it reads the end
    reached last, so it changes on arrival only.

    Args:
        label: as in the wiring.
        travel_time: from end to end [s].

    Attributes:
        position: 0..1.
        driven: whether its drive is on, 0 or 1.
        switches: how often its drive changed.
    """

    def __init__(self, label: str, travel_time: float) -> None:
        self.label = label
        self.position = 0.0
        self.switches = 0
        self._travel_time = travel_time
        self._slowness = 1.0
        self.driven = 0
        self._stuck: int | None = None
        self._end = 0
        self._frozen: int | None = None
        self._now: float | None = None

    @property
    def sensor(self) -> int:
        """What the end-stop switch reads."""
        return self._end if self._frozen is None else self._frozen

    @property
    def arrival(self) -> float | None:
        """When it will be where it is going [s], None when it is there."""
        way = abs(self._target - self.position)
        if way == 0.0 or self._now is None:
            return None
        return self._now + way * self._travel_time * self._slowness

    def drive(self, state: int, now: float) -> None:
        """Switches the drive off (0) or on (1)."""
        self.step(now)
        self.switches += state != self.driven
        self.driven = state

    def step(self, now: float) -> None:
        """Moves it on to the time `now` [s]."""
        elapsed = 0.0 if self._now is None else now - self._now
        self._now = now
        way = self._target - self.position
        time = self._travel_time * self._slowness
        if abs(way) * time <= elapsed + 1e-9:
            self.position = float(self._target)
            self._end = self._target
        else:
            self.position += elapsed / time * (1 if way > 0 else -1)

    def position_at(self, now: float) -> float:
        """Returns where it is at a time not before the last step [s]."""
        way = self._target - self.position
        if way == 0.0 or self._now is None:
            return self.position
        reach = (now - self._now) / (self._travel_time * self._slowness)
        return self._target if reach >= abs(way) else self.position + reach * (1 if way > 0 else -1)

    def stick(self, state: int) -> None:
        """Lets it go to an end and stay there, whatever its drive."""
        self._stuck = state

    def release(self) -> None:
        """Lets it follow its drive again."""
        self._stuck = None

    def slow(self, factor: float) -> None:
        """Makes its travel longer by a factor; 1 is as built."""
        self._slowness = factor

    def lose_sensor(self) -> None:
        """Freezes what the end-stop switch reads."""
        self._frozen = self.sensor

    def restore_sensor(self) -> None:
        """Lets the end-stop switch read again."""
        self._frozen = None

    @property
    def _target(self) -> int:
        return self.driven if self._stuck is None else self._stuck
