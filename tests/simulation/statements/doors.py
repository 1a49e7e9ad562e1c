"""When the executor must know that a door is open: inputs of its board have reached it since."""

from __future__ import annotations

import math

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.buses.bus_model import TPDOS

REACHED = 0.005  # [s] from a change of an input to the arrival of its TPDO


class Doors:
    """The interlocks of an arm.

    Attributes:
        known_at: when inputs have reached the executor since a door was opened; infinity before [s].
    """

    def __init__(self, arm: ExecutedArm) -> None:
        self._boards = {f"{lock.bus}/{lock.node}" for lock in arm.wiring.interlocks}
        self._opened_at = self.known_at = math.inf  # [s]

    def open(self, now: float) -> None:
        self._opened_at = min(self._opened_at, now)

    def close_all(self) -> None:
        self._opened_at = self.known_at = math.inf

    def hear(self, bus: str, frame: Frame, now: float) -> None:
        told = f"{bus}/{frame.id & 0x7F}" in self._boards and frame.id & 0x780 in TPDOS
        if told and now > self._opened_at + REACHED:
            self.known_at = min(self.known_at, now)

    def forget(self) -> None:
        """The executor has lost what boards told of doors."""
        self.known_at = math.inf
