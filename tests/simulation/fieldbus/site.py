"""Boards and buses of one arm with a CANopen master, on a simulated clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from random import Random

from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, Event, SendFailed
from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from hyperbit.drivers.simulation.variants import Variant
from tests.simulation.agenda import Agenda
from tests.simulation.buses.boards import AttachedBoards
from tests.simulation.buses.bus_model import BusModel, OnItsWay
from tests.simulation.faults.sight import Sight

TICK = 0.01  # [s] between two calls of the master
TOOL = "tool"  # cause of a change of pins by another program


class SeenBoards(AttachedBoards):
    """Boards whose site sees each change of their pins."""

    site: Site | None = None

    def see(self, cause: str, belongs_to: object = None) -> None:
        if self.site is not None:
            self.site.sees(cause, belongs_to)


class Site:
    """One arm: boards, buses, and a master that can be exchanged. Without a master it can be pickled.

    Attributes:
        master: the present master; None: no executor runs.
        stalled: whether the executor stands still; events wait for it.
        stage: whether the frames that the master sends now belong to a command, and not to a release or a boot.
    """

    def __init__(
        self, wiring: Wiring, timing: Timing, variants: Mapping[str, Variant], agenda: Agenda, random: Random
    ) -> None:
        self.wiring, self.timing, self.variants, self.agenda = wiring, timing, variants, agenda
        self.buses = {
            bus.name: BusModel(bus.name, bus.bitrate, agenda, random, self.to_boards, self.to_master)
            for bus in wiring.buses
        }
        self.running: Master | None = None
        self.stalled = self.stage = False
        self._failed: list[SendFailed] = []
        self._waiting: list[Event] = []
        self.boards = SeenBoards(wiring, timing, variants, agenda, self.from_board)
        self.boards.site = self
        agenda.after(TICK, self._tick)

    @cached_property
    def sight(self) -> Sight:
        return Sight(self.wiring, self.timing, self.boards, self.variants)

    @property
    def now(self) -> float:
        return self.agenda.now

    @property
    def master(self) -> Master:
        assert self.running is not None
        return self.running

    def board(self, name: str) -> SimulatedBoard:
        return self.boards.simulated.board(name)

    # --- the executor

    def start_master(self) -> Master:
        self._waiting.clear()
        self.stalled = False
        self.running = Master(self.wiring, self.timing, self._from_master)
        for name, bus in self.buses.items():
            self.tell(BusChanged(name, bus.state, "", None))
        return self.running

    def call(self, action: Callable[[Master], object]) -> None:
        """Calls the master, and tells it of frames that could not be sent."""
        action(self.master)
        while self._failed and self.running is not None:
            failed, self._failed = self._failed, []
            for event in failed:
                self.running.receive_event(event, self.now)

    def commit(self, states: int) -> None:
        self.stage = True
        self.call(lambda m: m.commit(states, self.now))

    def release(self, off: int) -> None:
        self.stage = False
        self.call(lambda m: m.release(off, self.now))

    def tell(self, event: Event) -> None:
        """Gives the master an event, now or after its stall."""
        if self.stalled and self.running is not None:
            self._waiting.append(event)
        elif self.running is not None:
            self.call(lambda m: m.receive_event(event, self.now))

    def stall(self, seconds: float) -> None:
        self.stalled = True
        self.agenda.after(seconds, self.go_on)

    def go_on(self) -> None:
        """Ends a stall: the master takes a tick, then all that has come."""
        if self.stalled:
            self.stalled = False
            self.tick()
            waiting, self._waiting = self._waiting, []
            for event in waiting:
                self.tell(event)

    def kill(self, dead: float) -> None:
        """Kills the executor; after a time [s] another one boots the boards."""
        self.running, self.stalled = None, False
        for bus in self.buses.values():
            bus.drop()
        self.agenda.after(dead, self.start_and_boot)

    def start_and_boot(self) -> None:
        if self.running is None:
            self.start_master()
            self.call(lambda m: m.boot(self.now))

    def _tick(self) -> None:
        self.agenda.after(TICK, self._tick)
        if not self.stalled:
            self.tick()

    def tick(self) -> None:
        if self.running is not None:
            self.call(lambda m: m.tick(self.now))

    # --- frames

    def _from_master(self, bus: str, frame: Frame) -> None:
        self.hands_out(bus, frame)
        if (why := self.buses[bus].send_frame(frame, self.stage)) is not None:
            self._failed.append(SendFailed(bus, frame, why))

    def hands_out(self, bus: str, frame: Frame) -> None:
        """Is called with each frame of the master before it is sent."""

    def sees(self, cause: str, belongs_to: object) -> None:
        """Is called when pins may have changed: by "time", "fault", a program of somebody else, or a frame."""

    def to_master(self, event: Event) -> None:
        self.tell(event)

    def to_boards(self, bus: str, sent: OnItsWay, lost: bool) -> None:
        if not lost:
            ours = sent.belongs_to is not None
            self.boards.receive(bus, sent.frame, cause_of(sent.frame) if ours else TOOL, sent.belongs_to)

    def from_board(self, bus: str, frame: Frame) -> None:
        self.buses[bus].from_board(frame)

    # --- what faults need

    def order(self, name: str, command: int) -> None:
        """Another program commands a board, unheard by the master."""
        bus, node = name.split("/")
        self.boards.receive(bus, Frame(cia301.NMT, bytes([command, int(node)])), TOOL)

    def moves(self) -> bool:
        """Whether frames under way may switch something."""
        master = self.running
        if master is None:
            return False
        switching = master.switching
        return bool(switching.under_way or switching.collecting or switching.leaving or master.booting.under_way)

    def pass_time(self, seconds: float) -> None:
        self.agenda.run(seconds)


def cause_of(frame: Frame) -> str:
    """Returns what a frame of the master is to the pins."""
    if frame.id == cia301.SYNC:
        return "SYNC"
    if frame.id == cia301.NMT:
        return "START" if frame.data[0] == Command.START else "NMT"
    if frame.id & ~0x7F == cia301.SDO_REQUEST:
        return "read" if frame.data[0] == 0x40 else "SDO"
    return "RPDO" if 0x200 <= frame.id < 0x580 else "frame"
