"""Buses and boards of an arm on one agenda, for tests that cause faults themselves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from random import Random

from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import Event
from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.variants import Variant
from tests.simulation.agenda import Agenda
from tests.simulation.buses.boards import AttachedBoards
from tests.simulation.buses.bus_model import BusModel, OnItsWay


class Hardware:
    """Buses and boards without faults.

    Attributes:
        lost: whether a frame of a board is lost.
    """

    def __init__(
        self,
        wiring: Wiring,
        timing: Timing,
        to_executor: Callable[[Event], None],
        variants: Mapping[str, Variant] | None = None,
    ) -> None:
        self.agenda = Agenda()
        self.buses = {
            bus.name: BusModel(bus.name, bus.bitrate, self.agenda, Random(bus.name), self._to_boards, to_executor)
            for bus in wiring.buses
        }
        self.lost: Callable[[str, Frame], bool] = lambda bus, frame: False
        self._attached = AttachedBoards(wiring, timing, variants, self.agenda, self._from_board)
        self.boards, self.fault = self._attached.simulated, self._attached.fault

    @property
    def now(self) -> float:
        return self.agenda.now

    def _to_boards(self, bus: str, sent: OnItsWay, lost: bool) -> None:
        if not lost:
            self._attached.receive(bus, sent.frame)

    def _from_board(self, bus: str, frame: Frame) -> None:
        if not self.lost(bus, frame):
            self.buses[bus].from_board(frame)
