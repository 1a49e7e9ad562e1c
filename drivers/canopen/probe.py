"""Asks each board of a wiring what it is, and changes nothing on it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.canopen import cia301, objects
from drivers.canopen.bus import CanBus
from drivers.canopen.cia301 import Frame
from drivers.canopen.device_type import check_type
from drivers.canopen.events import Changed, Echoed, Event, Received
from drivers.canopen.faults import Fault
from drivers.canopen.layout import BoardLayout, lay_out
from drivers.canopen.link import Link
from drivers.canopen.procedure import Procedure, Runner
from drivers.canopen.wiring import Wiring

_POLL = 0.001  # [s] between two looks at the buses
_STUCK_AFTER = 0.5  # [s]


@dataclass(frozen=True)
class Answer:
    """The answer of one board.

    Attributes:
        board: its name, e.g. "can0/5".
        ok: whether it is a CiA 401 board with the wired outputs and inputs, and reports no error.
        text: its answer, or what is wrong, in words.
    """

    board: str
    ok: bool
    text: str


class Probe:
    """Asks all boards of a wiring in parallel; pure like the master.

    Args:
        wiring: buses and boards.
        send: hands out a frame for a bus, by its name; must not call the probe.
    """

    def __init__(self, wiring: Wiring, send: Callable[[str, Frame], None]) -> None:
        self._links = {bus.name: Link(bus, send, _STUCK_AFTER) for bus in wiring.buses}
        self._boards = lay_out(wiring).boards
        self._runners = {(b.bus, b.node): Runner(b.node, self._links[b.bus]) for b in self._boards}
        self._answers: dict[str, Answer] = {}

    @property
    def answers(self) -> tuple[Answer, ...] | None:
        """The answers in the order of the boards; None while one is missing."""
        if len(self._answers) < len(self._boards):
            return None
        return tuple(self._answers[board.name] for board in self._boards)

    def start(self, now: float) -> None:
        """Begins to ask; all buses are open."""
        for link in self._links.values():
            link.changed("active", "", None, now)
        for board in self._boards:
            self._runners[board.bus, board.node].start(self._ask(board), self._note(board), now)

    def take(self, event: Event, now: float) -> None:
        """Takes an event of a bus."""
        link = self._links[event.bus]
        if isinstance(event, Changed):
            if (fault := link.changed(event.state, event.why, event.errors, now)) is not None:
                self._give_up(fault)
        elif isinstance(event, Echoed) and link.echoed(event.frame, now):
            return
        elif isinstance(event, Echoed | Received):
            function, node = cia301.split(event.frame.id)
            runner = self._runners.get((event.bus, node))
            if function == cia301.SDO_ANSWER and runner is not None and len(event.frame.data) == 8:
                runner.receive_sdo(event.frame.data, now)
                runner.check(now)

    def send_failed(self, bus: str, frame: Frame, now: float) -> None:
        """Notes that a frame was not sent."""
        self._links[bus].send_failed(frame, now)

    def tick(self, now: float) -> None:
        """Does what time brings."""
        for link in self._links.values():
            link.armed = link.usable  # nothing here moves: only so that a stuck bus is found
            if (fault := link.tick(now, now)) is not None:
                self._give_up(fault)
        for runner in self._runners.values():
            runner.tick(now)

    def _ask(self, board: BoardLayout) -> Procedure:
        kind = yield from objects.read(board.name, 0x1000, 0, size=4)
        check_type(board, kind)
        register = yield from objects.read(board.name, 0x1001, 0)
        text = f"device type {kind:08X}h, error register {register:02X}h"
        self._answers[board.name] = Answer(board.name, register == 0, text)

    def _note(self, board: BoardLayout) -> Callable[[Fault | None, float], None]:
        def ended(fault: Fault | None, now: float) -> None:
            if fault is not None:
                self._answers[board.name] = Answer(board.name, False, fault.message)

        return ended

    def _give_up(self, fault: Fault) -> None:
        for board in self._boards:
            if board.bus == fault.source and board.name not in self._answers:
                self._runners[board.bus, board.node].cancel()
                text = f"board {board.name} does not answer: {fault.message}"
                self._answers[board.name] = Answer(board.name, False, text)


def probe(wiring: Wiring, open_bus: Callable[..., CanBus] = CanBus) -> tuple[Answer, ...]:
    """Asks all boards, and blocks until they have answered or are given up.

    Raises:
        BusError: a bus cannot be opened.
    """
    buses = {settings.name: open_bus(settings) for settings in wiring.buses}
    try:
        for bus in buses.values():
            bus.open()
        return _run(wiring, list(buses.values()))
    finally:
        for bus in buses.values():
            bus.close()


def _run(wiring: Wiring, buses: Sequence[CanBus]) -> tuple[Answer, ...]:
    outbox: list[tuple[str, Frame]] = []
    asking = Probe(wiring, lambda bus, frame: outbox.append((bus, frame)))
    by_name = {bus.name: bus for bus in buses}

    def flush(now: float) -> None:
        while outbox:
            bus, frame = outbox.pop(0)
            if by_name[bus].send(frame) is not None:
                asking.send_failed(bus, frame, now)

    begun = time.monotonic()
    asking.start(begun)
    flush(begun)
    while (answers := asking.answers) is None:
        now = time.monotonic()
        for bus in buses:
            for event in bus.poll():
                asking.take(event, now)
                flush(now)
        asking.tick(now)
        flush(now)
        time.sleep(_POLL)
    return answers
