"""Feeds the judge with what the executor's process takes and does."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hyperbit.controller.executor.core.events import (
    ClientGone,
    ClientId,
    Event,
    ExecutorTick,
    FaultPlayed,
    FromClient,
    Health,
)
from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import Counts, Goodbye, Hello, Up, Welcome
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import FrameEchoed, FrameIgnored, FrameReceived, SendFailed
from tests.simulation.agenda import Agenda
from tests.simulation.executor.process import Witness
from tests.simulation.judge.clients import Client
from tests.simulation.judge.judge import Judge


class Feed(Witness):
    """Translates events and actions of the executor into plain facts."""

    def __init__(self, judge: Judge, agenda: Agenda, raised: Callable[[Sequence[int]], None]) -> None:
        self._judge, self._agenda, self._raised = judge, agenda, raised
        self._instances = 0
        self._planner: ClientId | None = None
        self._greeted: tuple[ClientId, Hello] | None = None

    def started(self) -> None:
        self._instances += 1
        self._judge.at(self._agenda.now)
        self._judge.begins(self._instances)
        self._planner = self._greeted = None

    def killed(self) -> None:
        self._judge.at(self._agenda.now)
        self._judge.dies()
        self._planner = None

    def hurries(self) -> None:
        self._judge.endings.hurries()

    def told(self, event: Event) -> None:
        judge = self._judge
        judge.at(self._agenda.now)
        match event:
            case ExecutorTick():
                judge.ticks()
            case FromClient(client, message):
                self._greeted = (client, message) if isinstance(message, Hello) else None
                if isinstance(message, Counts) and client == self._planner:
                    self._raised(message.counts)
                judge.messages.hears(Client(client.number, client == self._planner), message)
            case ClientGone(client):
                judge.messages.loses(Client(client.number, client == self._planner))
                if client == self._planner:
                    self._planner = None
            case FrameEchoed():
                judge.echoes(event.bus, event.frame.id)
                judge.counts.echoes(event.bus)
            case FrameReceived():
                judge.other_event()
                judge.counts.hears(event.bus, event.frame.id)
                judge.proofs.hears(event.bus, event.frame.id, event.frame.data)
                judge.snapshots.hears(event.bus, event.frame.id, event.frame.data)
            case FrameIgnored():
                judge.other_event()
                judge.counts.hears(event.bus, 0x100)
            case SendFailed(bus, frame, _):
                judge.fails(bus, frame.id)
            case Health(loop, dropped):
                judge.other_event()
                judge.counts.process(loop, dropped)
            case FaultPlayed(client, request, text, done):
                judge.other_event()
                judge.clients.played(client.number, request, text, done)
            case Quit():
                judge.quits()
            case _:
                judge.other_event()

    def sends(self, bus: str, frame: Frame) -> object:
        """Tells a frame that is handed out; returns the commit of a SYNC."""
        self._judge.at(self._agenda.now)
        return self._judge.hands_out(bus, frame.id, frame.data)

    def logs(self, level: int, text: str) -> None:
        self._judge.log.logs(level, text)
        self._judge.endings.logs(text)
        if text.startswith("starting:"):
            self._judge.pulses.boots()

    def notifies(self, text: str) -> None:
        self._judge.log.notifies(text)

    def tells(self, client: ClientId, message: Up) -> None:
        self._judge.clients.tells(client.number, message)

    def says(self, message: Up) -> None:
        if isinstance(message, Welcome) and self._greeted is not None:
            client, hello = self._greeted
            if hello.role == "planner":
                self._planner = client
                self._judge.messages.tells(message)
                self._judge.requests.new_planner()
                return
        if isinstance(message, Goodbye):
            self._judge.requests.answered()
        self._judge.messages.tells(message)


class Witnesses(Witness):
    """Several witnesses; a frame belongs to what each of them tells of it."""

    def __init__(self, *witnesses: Witness) -> None:
        self._witnesses = list(witnesses)

    def add(self, witness: Witness) -> None:
        self._witnesses.append(witness)

    def started(self) -> None:
        for witness in self._witnesses:
            witness.started()

    def killed(self) -> None:
        for witness in self._witnesses:
            witness.killed()

    def hurries(self) -> None:
        for witness in self._witnesses:
            witness.hurries()

    def told(self, event: Event) -> None:
        for witness in self._witnesses:
            witness.told(event)

    def sends(self, bus: str, frame: Frame) -> object:
        return tuple(witness.sends(bus, frame) for witness in self._witnesses)

    def says(self, message: Up) -> None:
        for witness in self._witnesses:
            witness.says(message)

    def tells(self, client: ClientId, message: Up) -> None:
        for witness in self._witnesses:
            witness.tells(client, message)

    def logs(self, level: int, text: str) -> None:
        for witness in self._witnesses:
            witness.logs(level, text)

    def notifies(self, text: str) -> None:
        for witness in self._witnesses:
            witness.notifies(text)
