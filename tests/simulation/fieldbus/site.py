"""Boards and buses of one arm with a CANopen master, on the clock of the world."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, SendFailed
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from tests.simulation.agenda import Agenda
from tests.simulation.buses.boards import AttachedBoards
from tests.simulation.buses.bus_model import BusModel, OnItsWay
from tests.simulation.fieldbus.arms import Drawn

TICK = 0.01  # [s] between two calls of the master
READS_INPUTS = b"\x00\x60"  # index of the inputs in an SDO frame
LATE = 0.03  # [s], delay of a late answer


class Attached(AttachedBoards):
    watch: Callable[[str], None] = staticmethod(lambda cause: None)

    def see(self, cause: str, belongs_to: object = None) -> None:
        self.watch(cause)


class Site:
    """One arm: boards, buses, and a master that can be exchanged.

    Attributes:
        master: the present master; None: no executor runs.
        stalled: whether the executor stands still.
        intercept: called with each frame of a board, or to one; returns "", "lose", "twice" or "late".
        echoes: takes bus, identifier and time of each frame of the master that was sent.
        hears: takes each frame of a board that reaches the master.
    """

    def __init__(self, drawn: Drawn, agenda: Agenda, random: Random) -> None:
        self.drawn, self.agenda = drawn, agenda
        self.buses = {
            bus.name: BusModel(bus.name, bus.bitrate, agenda, random, self._to_boards, self._to_master)
            for bus in drawn.wiring.buses
        }
        self.master: Master | None = None
        self.stalled = False
        self.intercept: Callable[[str, Frame], str] = lambda bus, frame: ""
        self.hands_out: Callable[[str, Frame], None] = lambda bus, frame: None
        self.echoes: Callable[[str, int, float], None] = lambda bus, cob_id, now: None
        self.ticked: Callable[[], None] = lambda: None
        self.hears: Callable[[str, Frame], None] = lambda bus, frame: None
        self._failed: list[SendFailed] = []
        self._waiting: list[Event] = []
        self.boards = Attached(drawn.wiring, drawn.timing, drawn.variants, agenda, self._from_board)
        agenda.after(TICK, self._tick)

    @property
    def now(self) -> float:
        return self.agenda.now

    def board(self, name: str) -> SimulatedBoard:
        return self.boards.simulated.board(name)

    def start_master(self) -> Master:
        self._waiting.clear()
        self.stalled = False
        self.master = Master(self.drawn.wiring, self.drawn.timing, self._from_master)
        for name, bus in self.buses.items():
            self.tell(BusChanged(name, bus.state, "", None))
        return self.master

    def call(self, action: Callable[[Master], object]) -> None:
        """Calls the master, and tells it of frames that could not be sent."""
        assert self.master is not None
        action(self.master)
        self._drain()

    def _drain(self) -> None:
        while self._failed and self.master is not None:
            failed, self._failed = self._failed, []
            for event in failed:
                self.master.receive_event(event, self.now)

    def tell(self, event: Event) -> None:
        """Gives the master an event, now or after its stall."""
        if self.master is None:
            return
        if self.stalled:
            self._waiting.append(event)
            return
        self.master.receive_event(event, self.now)
        self._drain()

    def go_on(self) -> None:
        """Ends a stall: the master takes a tick, then all that has come."""
        self.stalled = False
        if self.master is not None:
            self.call(lambda master: master.tick(self.now))
        waiting, self._waiting = self._waiting, []
        for event in waiting:
            self.tell(event)

    def _tick(self) -> None:
        self.agenda.after(TICK, self._tick)
        if self.master is not None and not self.stalled:
            self.call(lambda master: master.tick(self.now))
            self.ticked()

    def _from_master(self, bus: str, frame: Frame) -> None:
        self.hands_out(bus, frame)
        if (why := self.buses[bus].send_frame(frame)) is not None:
            self._failed.append(SendFailed(bus, frame, why))

    def _to_master(self, event: Event) -> None:
        if isinstance(event, FrameEchoed):
            self.echoes(event.bus, event.frame.id, self.now)
        self.tell(event)

    def _to_boards(self, bus: str, sent: OnItsWay, lost: bool) -> None:
        if lost:
            return
        what = self.intercept(bus, sent.frame)
        for _ in range({"lose": 0, "twice": 2}.get(what, 1)):
            self.boards.receive(bus, sent.frame, cause_of(sent.frame))

    def _from_board(self, bus: str, frame: Frame) -> None:
        what = self.intercept(bus, frame)
        self.hears(bus, frame)
        if what == "late":
            self.agenda.after(LATE, lambda: self.buses[bus].from_board(frame))
            return
        for _ in range({"lose": 0, "twice": 2}.get(what, 1)):
            self.buses[bus].from_board(frame)

    def order(self, name: str, command: int) -> None:
        """Another program sends an NMT command to a board, unheard by the master."""
        bus, node = name.split("/")
        frame = Frame(cia301.NMT, bytes([command, int(node)]))
        self.boards.receive(bus, frame, "foreign START" if command == Command.START else "foreign")


def cause_of(frame: Frame) -> str:
    """Returns what a frame of the master is to the pins."""
    if frame.id == cia301.SYNC:
        return "SYNC"
    if frame.id == cia301.NMT:
        return "START" if frame.data[0] == Command.START else "NMT"
    if frame.id & ~0x7F == cia301.SDO_REQUEST:
        return "read" if frame.data[0] == 0x40 else "SDO"
    return "RPDO" if 0x200 <= frame.id < 0x580 else "frame"
