"""The time of a replayed recording, from the messages of its timeline."""

import math
import time
from collections.abc import Callable
from typing import Literal

from hyperbit.controller.messages.state import Timeline

JITTER = 0.5  # [s]; a smaller step is the jitter of messages


class ReplayClock:
    """The present time in a recording. `clock`: CLOCK_MONOTONIC [s]. Not thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._at, self._heard, self._speed, self._end = 0.0, clock(), 0.0, math.inf

    def __call__(self) -> float:
        """Returns the present time in the recording, UNIX time [s]."""
        return min(self._at + (self._clock() - self._heard) * self._speed, self._end)

    def hear(self, timeline: Timeline) -> Literal["back", "forward"] | None:
        """Accepts a `timeline`; returns the direction of a jump, None if the replay runs on."""
        before, speed = self(), self._speed
        self._at, self._heard, self._end = timeline.at, self._clock(), timeline.end
        self._speed = 0.0 if timeline.paused else timeline.speed
        step, jitter = self._at - before, JITTER * max(speed, self._speed, 1.0)
        return "back" if step < -jitter else "forward" if step > jitter else None
