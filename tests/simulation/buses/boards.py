"""Simulated boards on an agenda, which steps them when something is due."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.buses import SimulatedBuses
from hyperbit.drivers.simulation.fault_commands import perform
from hyperbit.drivers.simulation.variants import Variant
from tests.simulation.agenda import Agenda


class AttachedBoards:
    """All boards of an arm, with power."""

    def __init__(
        self,
        wiring: Wiring,
        timing: Timing,
        variants: Mapping[str, Variant] | None,
        agenda: Agenda,
        send: Callable[[str, Frame], None],
    ) -> None:
        self.simulated = SimulatedBuses(wiring, timing, send, variants)
        self._agenda, self._timer = agenda, float("inf")
        self.step()

    def see(self, cause: str, belongs_to: object = None) -> None:
        """Is called when outputs may have changed.

        Args:
            cause: "time", "fault", or a frame.
            belongs_to: the commit of a frame.
        """

    def receive(self, bus: str, frame: Frame, cause: str = "frame", belongs_to: object = None) -> None:
        self.simulated.step(self._agenda.now)
        self.see("time")
        self.simulated.receive(bus, frame, self._agenda.now)
        self.see(cause, belongs_to)
        self.set_timer()

    def fault(self, verb: str, name: str, *numbers: float | str) -> None:
        self.step()
        perform(self.simulated, verb, name, *numbers)
        self.see("fault")
        self.set_timer()

    def step(self) -> None:
        self.simulated.step(self._agenda.now)
        self.see("time")
        self.set_timer()

    def set_timer(self) -> None:
        due = self.simulated.next_due()
        if due < self._timer - 1e-12:
            self._timer = due
            self._agenda.at(due, lambda: self._ring(due))

    def _ring(self, due: float) -> None:
        if due == self._timer:
            self._timer = float("inf")
            self.step()
