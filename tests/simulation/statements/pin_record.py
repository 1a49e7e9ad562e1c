"""What the boards drive, what end-stops read, and when doors are open, as the judge sees it from outside."""

from __future__ import annotations

import math
from collections import deque

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.agenda import Agenda
from tests.simulation.buses.bus_model import TPDOS
from tests.simulation.statements.arm import JudgedArm, bits_of, merged
from tests.simulation.statements.motions import Energised, Pins, Switch

REMEMBERED = 100  # pins and readings
REACHED = 0.005  # [s] from a change of an input to the arrival of its TPDO


class PinRecord:
    """The pins of an arm.

    Attributes:
        switched_at: when pins of each actuator changed last [s].
        changed_at: when its end-stops changed last [s].
        missed: mask of the actuators whose boards have missed a frame since their boot; where nobody reads the outputs
            back, since their last switch.
        fallen: mask of the actuators whose outputs changed without a SYNC since the boot.
    """

    def __init__(self, arm: JudgedArm, agenda: Agenda) -> None:
        self._arm, self._agenda = arm, agenda
        self._all = deque([Pins(-math.inf, 0, 0, 0, 0)], maxlen=REMEMBERED)
        self.switched_at = [-math.inf] * arm.count
        self.changed_at = [-math.inf] * arm.count
        self.missed = self.fallen = 0

    @property
    def now(self) -> Pins:
        return self._all[-1]

    def since(self, at: float) -> list[Pins]:
        """Returns all pins that held at a time or later, the newest first."""
        found: list[Pins] = []
        for pins in reversed(self._all):
            found.append(pins)
            if pins.at <= at:
                break
        return found

    def due(self, k: int) -> float:
        """Returns when an actuator has arrived at the latest, by its travel time [s]."""
        return self.switched_at[k] + self._arm.travel[k][self.now.states >> k & 1]

    @property
    def arrived(self) -> int:
        """Mask of the actuators whose end-stop at the end to which they are driven tells that they are there."""
        pins, arm = self.now, self._arm
        extended = pins.states & arm.extended_ends & pins.extended
        return extended | ~pins.states & arm.contracted_ends & pins.contracted

    def elsewhere(self, states: int) -> int:
        """Returns the mask of the actuators that are not in `states`: with no coil on, an end-stop may tell it."""
        pins, arm = self.now, self._arm
        read = arm.measured(pins.extended, pins.contracted, pins.states)
        return (states ^ pins.states) & ((states ^ read) | ~arm.paired | pins.on)

    def drive(self, states: int) -> None:
        """Takes the ends to which the actuators are driven at the begin of the world."""
        self._all.append(self.now._replace(states=states))

    def switch(self, switch: Switch) -> None:
        self._touch(switch.mask, self.switched_at)
        self.fallen |= switch.mask * (switch.cause != "SYNC")
        self.missed &= ~(switch.mask & self._arm.forgone)
        states = merged(switch.mask, switch.after, self.now.states)
        self._all.append(self.now._replace(at=self._agenda.now, states=states))

    def energise(self, coils: Energised) -> None:
        self._touch(coils.came, self.switched_at)
        of_bus = sum(1 << k for k, bus in enumerate(self._arm.bus_of) if bus == coils.bus)
        self._all.append(self.now._replace(at=self._agenda.now, on=merged(of_bus, coils.on, self.now.on)))

    def read(self, extended: int, contracted: int) -> None:
        self._touch((self.now.extended ^ extended) | (self.now.contracted ^ contracted), self.changed_at)
        self._all.append(self.now._replace(at=self._agenda.now, extended=extended, contracted=contracted))

    def booted(self) -> None:
        """The outputs were read back."""
        self.missed, self.fallen = self.missed & self._arm.forgone, 0

    def _touch(self, mask: int, times: list[float]) -> None:
        for k in bits_of(mask):
            times[k] = self._agenda.now


class Doors:
    """The interlocks of an arm: when the executor must know that a door is open.

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
