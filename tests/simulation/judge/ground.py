"""The ground: outputs, end-stops and positions as they are in the world, with what they were a moment ago."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple, TypeVar

from tests.simulation.judge.arm import JudgedArm, bits_of


class Reading(NamedTuple):
    """Levels of the end-stops from a time on, as masks of actuators.

    Attributes:
        at: begin [s].
        extended: the end-stop at the extended end reads 1.
        contracted: the end-stop at the contracted end reads 1.
    """

    at: float
    extended: int
    contracted: int


class Driven(NamedTuple):
    """Ends to which the actuators are driven from a time on.

    Attributes:
        at: begin [s].
        states: as a mask; with two outputs by the output that was on last.
    """

    at: float
    states: int


class Ground:
    """What the boards drive and what the end-stops read.

    Attributes:
        readings: the last readings, the newest last.
        driven: the last driven states, the newest last.
        switched_at: time when each actuator was switched last [s].
        synced_at: time when a SYNC has switched it last, as far as its board has missed no frame [s].
        on: mask of the actuators with one of two outputs on.
    """

    def __init__(self, arm: JudgedArm) -> None:
        self.arm = arm
        self.readings = deque([Reading(-1e12, 0, 0)], maxlen=50)
        self.driven = deque([Driven(-1e12, 0)], maxlen=50)
        self.switched_at = [-1e12] * arm.count
        self.synced_at = [-1e12] * arm.count
        self.synced_to = dict[int, int]()  # the state to which that SYNC has brought it
        self.on = 0
        self._came_at = [-1e12] * arm.count

    @property
    def states(self) -> int:
        return self.driven[-1].states

    def read(self, now: float, extended: int, contracted: int) -> None:
        if self.readings[-1][1:] != (extended, contracted):
            self.readings.append(Reading(now, extended, contracted))

    def drive(self, now: float, states: int, changed: int) -> None:
        self.driven.append(Driven(now, states))
        for k in bits_of(changed):
            self.switched_at[k] = now

    def energise(self, now: float, on: int, came: int) -> None:
        """Records that one of two outputs of actuators came on: an actuator of unknown state may travel."""
        self.on = on
        for k in bits_of(came):
            self.switched_at[k] = self._came_at[k] = now

    def came_since(self, since: float) -> int:
        """Returns the mask of the actuators of which one of two outputs came on since a time [s]."""
        return sum(1 << k for k, at in enumerate(self._came_at) if at >= since)

    def readings_since(self, since: float) -> list[Reading]:
        """Returns all readings that held at a time or later."""
        return _since(self.readings, since)

    def states_since(self, since: float) -> list[int]:
        """Returns all driven states that held at a time or later."""
        return [driven.states for driven in _since(self.driven, since)]

    def arrived(self, k: int, reading: Reading) -> bool:
        """Returns whether the end-stops of an actuator fit the state to which it is driven."""
        state, bit = self.states >> k & 1, 1 << k
        new, old = (reading.extended, reading.contracted) if state else (reading.contracted, reading.extended)
        ends = self.arm.extended_ends, self.arm.contracted_ends
        new_end, old_end = ends if state else ends[::-1]
        return not (new_end & bit and not new & bit) and not (old_end & bit and old & bit)

    def due(self, k: int) -> float:
        """Returns the time at which an actuator arrives at the latest, by its travel time [s]."""
        return self.switched_at[k] + self.arm.travel[k][self.states >> k & 1]

    def switched_since(self, since: float) -> int:
        return sum(1 << k for k in range(self.arm.count) if self.switched_at[k] > since)

    def surely_moving(self, now: float) -> int:
        """Returns the mask of the actuators that nobody may call arrived.

        With an end-stop at the new end that end-stop tells. Without one the travel time tells.
        """
        last, mask = self.readings[-1], 0
        for k in range(self.arm.count):
            ends = self.arm.extended_ends if self.states >> k & 1 else self.arm.contracted_ends
            if now < self.due(k) and not (ends >> k & 1 and self.arrived(k, last)):
                mask |= 1 << k
        return mask

    def surely_at_rest(self, now: float, delay: float) -> bool:
        """Returns whether each actuator has arrived, and was seen to arrive, a delay ago [s]."""
        readings = self.readings_since(now - delay)
        return all(
            now > self.due(k) + delay and all(self.arrived(k, reading) for reading in readings)
            for k in range(self.arm.count)
        )


T = TypeVar("T", Reading, Driven)


def _since(history: deque[T], since: float) -> list[T]:
    found: list[T] = []
    for entry in reversed(history):
        found.append(entry)
        if entry.at <= since:
            break
    return found
