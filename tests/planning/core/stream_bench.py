"""The planner's stream of set-points on a simulated clock; the test plays executor and worker."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.tracking.tracking import tracking_of
from hyperbit.controller.planning.core.events import Arrival, SetpointArrived
from hyperbit.controller.planning.core.parts import Ticket
from hyperbit.controller.planning.core.stream import Stream
from hyperbit.controller.planning.core.tasks import Followed, FollowSetpoint
from tests.planning.rig.played_core import PlayedCore

A = (5, 0, 7, 0)
EVERY = 0.02  # [s] between set-points
TICK = 0.001  # [s] of the simulated clock


class StreamBench(PlayedCore):
    """A stream whose set-points come 50 times a second while `position` is set."""

    def __init__(self, arm: Arm, bias: tuple[float, ...] | None = None) -> None:
        super().__init__(arm)
        tracking = tracking_of(arm.manipulator.length, arm.tolerance)
        self.timeout = tracking.timeout
        estimator = SimpleNamespace(bias=lambda: np.array(bias))
        premises = self.premises._replace(tip_bias=None if bias is None else estimator)
        self.stream = Stream(arm, tracking, self.parts, premises, self.programs)
        self.position: list[float] | None = None
        self.first: Ticket | None = None  # of the last stream
        self.steps, self._next = 0, self.now
        self.numbers, self.delay = 0, 0.0  # of arrivals; between an arrival and the core [s]
        self.show()

    def put(self, payload: Any, sender: str = "") -> None:
        self.numbers += 1
        arrival = Arrival(self.numbers, self.now - self.delay)
        self.stream.receive_setpoint(SetpointArrived(json.dumps(payload).encode(), arrival, sender))
        self.first = self.first or self.stream._ticket

    def step(self) -> None:
        self.steps += 1
        self.stream.consider()

    def run(self, seconds: float) -> None:
        """Lets time pass; the core steps when a set-point comes, and when the stream is due."""
        for _ in range(round(seconds / TICK)):
            arrived = self.position is not None and self.now >= self._next
            if arrived:
                self._next = self.now + EVERY
                self.put({"position": self.position, "tolerance": {"position": 0.01}})
            if arrived or self.now >= self.stream.due:
                self.step()
            self.advance(TICK)

    def search(self) -> tuple[int, FollowSetpoint]:
        """Follows a position until its search begins."""
        self.position = self.position or self.tip(*A)
        self.run(TICK)
        return self.task(FollowSetpoint)

    def found(self, number: int, stages: tuple[bytes, ...] = (), note: str = "", found: bool = True) -> None:
        self.answer(number, Followed(stages, note, found, 0.004))
        self.step()

    def status(self) -> dict[str, Any]:
        return dict(self.stream.status())
