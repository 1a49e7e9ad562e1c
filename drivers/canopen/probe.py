"""Asks each board of a wiring what it is and holds, as the boot does, and changes nothing on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from drivers.canopen import cia301, inspection, objects, pdo_search
from drivers.canopen.boot import find
from drivers.canopen.bus import CanBus
from drivers.canopen.cia301 import Frame
from drivers.canopen.conversation import converse
from drivers.canopen.events import Changed, Echoed, Event, Received
from drivers.canopen.faults import Fault
from drivers.canopen.inspection import Inspection, Reading
from drivers.canopen.layout import BoardLayout, lay_out
from drivers.canopen.link import Link
from drivers.canopen.objects import Need
from drivers.canopen.pdo import Pdo
from drivers.canopen.pdo_setup import Held, pdo_words, usable
from drivers.canopen.procedure import BoardError, Procedure, Runner
from drivers.canopen.wiring import Timing, Wiring

_STUCK_AFTER = 0.5  # [s]
_PATIENCE = 1.0  # [s] for the first answer of a board
_MOST_CHANGES = 4  # that are told in full
_HARMLESS = (0x1029, 0x6206, 0x6207)


@dataclass(frozen=True)
class Answer:
    """The answer of one board.

    Attributes:
        board: its name, e.g. "can0/5".
        ok: whether it can be booted, and reports no error.
        text: what it is, what the boot will write and what is to be known; or what is wrong.
    """

    board: str
    ok: bool
    text: str


class Probe:
    """Asks all boards of a wiring in parallel; pure like the master.

    Args:
        wiring: buses and boards.
        timing: of heartbeats.
        send: hands out a frame for a bus, by its name; must not call the probe.
    """

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None:
        self._timing, self._error_state = timing, wiring.error_state
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

    @property
    def over(self) -> bool:
        """Whether all boards have answered or are given up."""
        return self.answers is not None

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
        kind, _ = yield from find(board, _PATIENCE, None)
        it = Inspection(board)
        yield from inspection.inspect(it, kind, self._timing, self._error_state)
        yield from pdo_search.read_pdos(it, in_full=True)
        unmet = it.unmet(it.needs) + it.unmet(it.error_mode)
        changes = [f"{n.place} {n.words(it.held[n.index, n.sub])} -> {n.words(n.corrected(0))}" for n in unmet]
        for need in unmet:
            yield from _try(it, need)
        for pdos in (it.rpdos, it.tpdos):
            yield from _try_mappings(it, pdos)
        for wanted, held in it.rpdos + it.tpdos:
            if not held.fits(wanted):
                changes.append(
                    f"{held.parameters:04X}h and {held.parameters + 0x200:04X}h ({pdo_words(held.parameters)})"
                )
        register, errors, lost = yield from inspection.read_errors(it, None)
        text = f"device type {kind:08X}h, "
        text += errors or "error register 00h"
        if changes:
            text += f"; to be written: {'; '.join(changes[:_MOST_CHANGES])}"
            text += f"; and {len(changes) - _MOST_CHANGES} more" * (len(changes) > _MOST_CHANGES)
        for warning in it.warnings:
            text += f"; {warning}"
        self._answers[board.name] = Answer(board.name, not register or lost, text)

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


def _try(it: Inspection, need: Need) -> Reading:
    """Refuses an object that cannot be written: a write of what it holds changes nothing, and shows it.

    What matters in the error state only is written for a moment, for some boards confirm it and do not take it.
    """
    held = it.held[need.index, need.sub]
    if need.index in _HARMLESS:
        yield from objects.settle(it.name, need, held)
        yield from objects.settle(it.name, replace(need, value=held, mask=0xFF), need.corrected(held))
        return
    if (abort := (yield from objects.write(it.name, need, held))) == objects.READ_ONLY:
        raise objects.refused(it.name, need, held, abort)


def _try_mappings(it: Inspection, pdos: list[tuple[Pdo, Held]]) -> Reading:
    """Refuses PDOs that cannot be mapped as is wanted, unless others carry the process data as they are."""
    try:
        for wanted, held in pdos:
            if not held.fits(wanted):
                yield from _try_mapping(it, wanted, held)
    except BoardError:
        other = None if it.layout.shared else (yield from pdo_search.cover(it, pdos))
        if other is None:
            raise
        pdos[:] = other[0]


def _try_mapping(it: Inspection, wanted: Pdo, held: Held) -> Reading:
    """Refuses a mapping that does not carry what is needed and cannot be written."""
    base = 0x200 if wanted.parameters < 0x1800 else 0x180
    enabled = held._replace(cob_id=base + it.layout.node, kind=255, timer=None)
    why = usable(it.layout, wanted, enabled)
    if it.layout.shared and wanted.parameters < 0x1800 and held.mapping != wanted.mapping:
        why = f"{pdo_words(wanted.parameters)} cannot be shared with other boards as the arm's file says (shared_rpdo)"
    if why is None:
        return
    need = Need(held.parameters + 0x200, 0, held.entries)
    if (abort := (yield from objects.write(it.name, need, held.entries))) == objects.READ_ONLY:
        text = f"board {it.name}: {why}; it refuses to be mapped anew: {objects.abort_words(abort)}"
        raise BoardError(Fault("sdo-refused", it.name, text))


def probe(wiring: Wiring, timing: Timing, open_bus: Callable[..., CanBus] = CanBus) -> tuple[Answer, ...]:
    """Asks all boards, and blocks until they have answered or are given up.

    Raises:
        BusError: a bus cannot be opened.
    """
    outbox: list[tuple[str, Frame]] = []
    asking = Probe(wiring, timing, lambda bus, frame: outbox.append((bus, frame)))
    converse(asking, outbox, [open_bus(settings) for settings in wiring.buses])
    assert asking.answers is not None
    return asking.answers
