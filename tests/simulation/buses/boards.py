"""Simulated boards on an agenda, which steps them when something is due; also with buses, without faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from random import Random

from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import Event
from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.buses import SimulatedBuses
from hyperbit.drivers.simulation.fault_commands import perform
from hyperbit.drivers.simulation.variants import Variant
from tests.simulation.agenda import Agenda
from tests.simulation.buses.bus_model import BusModel, OnItsWay


class AttachedBoards:
    """All boards of an arm, with power.

    Attributes:
        loses: a board and the function code of a frame, of which it loses the next one; None: it loses none.
    """

    def __init__(
        self,
        wiring: Wiring,
        timing: Timing,
        variants: Mapping[str, Variant] | None,
        agenda: Agenda,
        send: Callable[[str, Frame], None],
    ) -> None:
        self.loses: tuple[str, int] | None = None
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
        if self.simulated.next_due() <= self._agenda.now:
            self.simulated.step(self._agenda.now)
            self.see("time")
        deaf = self.deaf_to(bus, frame)
        if deaf is not None:
            self.loses = None
            board = self.simulated.board(deaf)
            silent, board.silent = board.silent, True
        self.simulated.receive(bus, frame, self._agenda.now)
        if deaf is not None:
            board.silent = silent
        self.see(cause, belongs_to)
        self.set_timer()

    def deaf_to(self, bus: str, frame: Frame) -> str | None:
        """Returns the board that loses a frame which all others receive."""
        if self.loses is None:
            return None
        board, function = self.loses
        heard = board.startswith(f"{bus}/") and frame.id in (function, function + int(board.split("/")[1]))
        return board if heard else None

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
            self._agenda.at(due, partial(self._ring, due))

    def _ring(self, due: float) -> None:
        if due == self._timer:
            self._timer = float("inf")
            self.step()


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
