"""Checks each board of a wiring as the boot does, and changes no value on it (`check --bus`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.canopen.boot import inspection, pdo_search
from drivers.canopen.boot.board_boot import find
from drivers.canopen.boot.inspection import Inspection, Reading
from drivers.canopen.boot.pdo_setup import PdoState, pdo_words, usable
from drivers.canopen.faults import ArmFault
from drivers.canopen.layout import BoardLayout, lay_out
from drivers.canopen.pdo import Pdo
from drivers.canopen.sdo import objects
from drivers.canopen.sdo.objects import Need
from drivers.canopen.sdo.procedure import BoardError, Procedure, Runner
from drivers.canopen.tools.conversation import converse
from drivers.canopen.tools.node_states import NodeStates, stopped
from drivers.canopen.wire import cia301
from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Frame, State
from drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, FrameReceived
from drivers.canopen.wire.link import Link
from drivers.canopen.wiring import Timing, Wiring

_STUCK_AFTER = 0.5  # [s]
_BOARD_TIMEOUT = 1.0  # [s] for the first answer of a board
_MOST_CHANGES = 4  # changes that the answer lists


@dataclass(frozen=True)
class CheckedBoard:
    """What the check has found on one board.

    Attributes:
        board: name of the board, e.g. "can0/5".
        text: its device type, the values that the boot will write, and its limits; or what is wrong.
        code: code of what is wrong, as of a fault; "": it can be booted and reports no error.
    """

    board: str
    text: str
    code: str = ""

    @property
    def ok(self) -> bool:
        """Whether the board can be booted and reports no error."""
        return not self.code


class BusCheck:
    """Asks all boards of a wiring in parallel; without I/O and clock, like the master.

    It writes only values that the objects have already, to find read-only objects. So no frame that is lost, and no end
    of the process, leaves another value on a board.

    Args:
        wiring: buses and boards.
        timing: heartbeat times.
        send: hands out a frame for a bus, by its name; must not call the check.
    """

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None:
        self._timing, self._error_state = timing, wiring.error_state
        self._links = {bus.name: Link(bus, send, _STUCK_AFTER) for bus in wiring.buses}
        self._states = {name: NodeStates(link) for name, link in self._links.items()}
        self._boards = lay_out(wiring).boards
        self._runners = {(b.bus, b.node): Runner(b.node, self._links[b.bus]) for b in self._boards}
        self._answers: dict[str, CheckedBoard] = {}

    @property
    def answers(self) -> tuple[CheckedBoard, ...] | None:
        """The answers in the order of the boards; None until all are there."""
        if len(self._answers) < len(self._boards):
            return None
        return tuple(self._answers[board.name] for board in self._boards)

    @property
    def master_on(self) -> str | None:
        """Name of a bus on which a master, such as an executor, sends its heartbeat; None if there is none."""
        return next((name for name, states in self._states.items() if states.master_heard), None)

    @property
    def over(self) -> bool:
        """Whether all boards have answered or timed out."""
        return self.answers is not None

    def start(self, now: float) -> None:
        """Starts to ask. All buses are open."""
        for link in self._links.values():
            link.changed("active", "", None, now)
        for board in self._boards:
            self._runners[board.bus, board.node].start(self._ask(board), self._note(board), now)

    def receive_event(self, event: Event, now: float) -> None:
        """Takes an event of a bus."""
        link = self._links[event.bus]
        if isinstance(event, BusChanged):
            if (fault := link.changed(event.state, event.why, event.errors, now)) is not None:
                self._give_up(fault)
        elif isinstance(event, FrameEchoed) and link.echoed(event.frame, now):
            return
        elif isinstance(event, FrameEchoed | FrameReceived):
            self._states[event.bus].hear(event.frame)
            function, node = cia301.split(event.frame.id)
            runner = self._runners.get((event.bus, node))
            if function == cia301.SDO_ANSWER and runner is not None and len(event.frame.data) == 8:
                runner.receive_sdo(event.frame.data, now)
                runner.check(now)

    def send_failed(self, bus: str, frame: Frame, now: float) -> None:
        """Records that a frame could not be sent."""
        self._links[bus].send_failed(frame, now)

    def tick(self, now: float) -> None:
        """Call every millisecond: handles timeouts."""
        for states in self._states.values():
            states.tick(now)
        for link in self._links.values():
            link.armed = link.usable  # so that a stuck bus is found; nothing is switched here
            if (fault := link.tick(now, now)) is not None:
                self._give_up(fault)
        for runner in self._runners.values():
            runner.tick(now)

    def _ask(self, board: BoardLayout) -> Procedure:
        try:
            kind, _ = yield from find(board, _BOARD_TIMEOUT, None)
        except BoardError as error:
            if error.fault.code == "board-missing":
                yield from self._refuse_heard(board)
            raise
        it = Inspection(board)
        yield from inspection.inspect(it, kind, self._timing, self._error_state)
        yield from pdo_search.read_pdos(it, in_full=True)
        unmet = it.unmet(it.needs) + it.unmet(it.error_mode)
        changes = [f"{n.place} {n.words(it.values[n.index, n.sub])} -> {n.words(n.corrected(0))}" for n in unmet]
        for need in unmet:
            yield from _try(it, need)
        for pdos in (it.rpdos, it.tpdos):
            yield from _try_mappings(it, pdos)
        for wanted, present in it.rpdos + it.tpdos:
            if not present.fits(wanted):
                changes.append(
                    f"{present.parameters:04X}h and {present.parameters + 0x200:04X}h ({pdo_words(present.parameters)})"
                )
        register, errors, lost = yield from inspection.read_errors(it, None)
        text = f"device type {kind:08X}h, "
        text += errors or "error register 00h"
        if changes:
            text += f"; to be written: {'; '.join(changes[:_MOST_CHANGES])}"
            text += f"; and {len(changes) - _MOST_CHANGES} more" * (len(changes) > _MOST_CHANGES)
        for warning in it.warnings:
            text += f"; {warning}"
        code = "board-error" if register and not lost else ""
        self._answers[board.name] = CheckedBoard(board.name, text, code)

    def _refuse_heard(self, board: BoardLayout) -> Reading:
        """Refuses a board that answers no SDO, but sends heartbeats or answers a remote frame."""
        states = self._states[board.bus]
        yield from states.learn(board.node)
        state = states.states.get(board.node)
        if state is State.STOPPED:
            raise BoardError(ArmFault("board-stopped", board.name, stopped(board.name)))
        if state is not None:
            text = (
                f"board {board.name} is {state.words}, but does not answer to 1000h sub 0 within {_BOARD_TIMEOUT:g} s"
            )
            raise BoardError(ArmFault("board-missing", board.name, text))

    def _note(self, board: BoardLayout) -> Callable[[ArmFault | None, float], None]:
        def ended(fault: ArmFault | None, now: float) -> None:
            if fault is not None:
                self._answers[board.name] = CheckedBoard(board.name, fault.message, fault.code)

        return ended

    def _give_up(self, fault: ArmFault) -> None:
        for board in self._boards:
            if board.bus == fault.source and board.name not in self._answers:
                self._runners[board.bus, board.node].cancel()
                text = f"board {board.name} does not answer: {fault.message}"
                self._answers[board.name] = CheckedBoard(board.name, text, fault.code)


def _try(it: Inspection, need: Need) -> Reading:
    """Refuses an object that cannot be written: writes its present value, which changes nothing."""
    present = it.values[need.index, need.sub]
    if (abort := (yield from objects.write(it.name, need, present))) == objects.READ_ONLY:
        raise objects.refused(it.name, need, present, abort)


def _try_mappings(it: Inspection, pdos: list[tuple[Pdo, PdoState]]) -> Reading:
    """Refuses PDOs that cannot be mapped as wanted, unless other PDOs carry the process data already."""
    try:
        for wanted, present in pdos:
            if not present.fits(wanted):
                yield from _try_mapping(it, wanted, present)
    except BoardError:
        other = None if it.layout.shared else (yield from pdo_search.cover(it, pdos))
        if other is None:
            raise
        pdos[:] = other[0]


def _try_mapping(it: Inspection, wanted: Pdo, present: PdoState) -> Reading:
    """Refuses a mapping that lacks needed bits and cannot be written."""
    base = 0x200 if wanted.parameters < 0x1800 else 0x180
    enabled = present._replace(cob_id=base + it.layout.node, kind=255, timer=None)
    why = usable(it.layout, wanted, enabled)
    if it.layout.shared and wanted.parameters < 0x1800 and present.mapping != wanted.mapping:
        why = f"{pdo_words(wanted.parameters)} cannot be shared with other boards as the arm's file says (shared_rpdo)"
    if why is None:
        return
    need = Need(present.parameters + 0x200, 0, present.entries)
    if (abort := (yield from objects.write(it.name, need, present.entries))) == objects.READ_ONLY:
        text = f"board {it.name}: {why}; it refuses another mapping: {objects.abort_words(abort)}"
        raise BoardError(ArmFault("sdo-refused", it.name, text))


def check_bus(wiring: Wiring, timing: Timing) -> BusCheck:
    """Asks all boards; blocks until they have answered or timed out.

    Raises:
        BusError: a bus cannot be opened.
    """
    outbox: list[tuple[str, Frame]] = []
    asking = BusCheck(wiring, timing, lambda bus, frame: outbox.append((bus, frame)))
    converse(asking, outbox, [CanBus(settings) for settings in wiring.buses])
    return asking
