"""Checks each board of a wiring as the boot does, and changes no value on it (`check --bus`)."""

from __future__ import annotations

from dataclasses import dataclass

from hyperbit.drivers.canopen.boot import inspection, pdo_search
from hyperbit.drivers.canopen.boot.board_boot import find
from hyperbit.drivers.canopen.boot.inspection import Inspection, Reading
from hyperbit.drivers.canopen.boot.pdo_setup import PdoState, pdo_words, usable
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.layout import BoardLayout, lay_out
from hyperbit.drivers.canopen.pdo import Pdo
from hyperbit.drivers.canopen.sdo import errors, objects
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import BoardError, Procedure
from hyperbit.drivers.canopen.tools.session import Node, Session, stopped
from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.canopen.wiring import Timing, Wiring

_BOARD_TIMEOUT = 1.0  # [s] for the first answer of a board
_REFUSALS = (objects.READ_ONLY, objects.BUSY)  # of the present value: `run` could not write another one
_UNDECIDED = "only run can tell whether it can be booted"
_MOST_CHANGES = 4  # changes that the answer lists


@dataclass(frozen=True)
class CheckedBoard:
    board: str  # name, e.g. "can0/5"
    text: str  # device type, values that the boot will write, and limits; or the fault
    code: str = ""  # code of the fault; "": the board can be booted and reports no error


def check_bus(session: Session, wiring: Wiring, timing: Timing) -> list[CheckedBoard]:
    """Asks all boards in parallel; returns their answers, after that of each bus that cannot be used.

    The check writes only values that the objects have already, to find read-only objects. So neither a lost frame nor
    the end of the process leaves another value on a board. Raises MasterHeard.
    """
    boards = {(board.bus, board.node): board for board in lay_out(wiring).boards}
    texts: dict[Node, CheckedBoard] = {}
    faults = session.run({node: _ask(session, board, timing, wiring, texts) for node, board in boards.items()})
    troubles = {bus.name: session.trouble(bus.name) for bus in wiring.buses}
    answers = [CheckedBoard(bus, fault.message, fault.code) for bus, fault in troubles.items() if fault is not None]
    for node, board in boards.items():
        if (fault := faults[node]) is None:
            answers.append(texts[node])
        elif (trouble := troubles[node[0]]) is None:
            answers.append(CheckedBoard(board.name, fault.message, fault.code))
        else:
            cause = trouble.message.partition(": check")[0]
            answers.append(CheckedBoard(board.name, f"board {board.name} does not answer: {cause}", trouble.code))
    return answers


def _ask(
    session: Session, board: BoardLayout, timing: Timing, wiring: Wiring, texts: dict[Node, CheckedBoard]
) -> Procedure:
    yield from objects.patient(_inspect(session, board, timing, wiring, texts), timing.boot_timeout)


def _inspect(
    session: Session, board: BoardLayout, timing: Timing, wiring: Wiring, texts: dict[Node, CheckedBoard]
) -> Procedure:
    node = board.bus, board.node
    try:
        kind, _ = yield from find(board, _BOARD_TIMEOUT, None)
    except BoardError as error:
        if error.fault.code != "board-missing":
            raise
        yield from session.poll_state(node)  # it may send heartbeats, or answer a remote frame
        if (state := session.states.get(node)) is None:
            raise
        if state is State.STOPPED:
            raise BoardError(ArmFault("board-stopped", board.name, f"{stopped(board.name)}; {_UNDECIDED}")) from None
        text = f"board {board.name} is {state.words}, but does not answer to 1000h sub 0 within {_BOARD_TIMEOUT:g} s"
        raise BoardError(ArmFault("board-missing", board.name, text)) from None
    it = Inspection(board)
    yield from inspection.inspect(it, kind, timing, wiring.error_state)
    yield from pdo_search.read_pdos(it, in_full=True)
    unmet = it.unmet(it.needs) + it.unmet(it.error_mode)
    changes = [f"{n.place} {n.words(it.values[n.index, n.sub])} -> {n.words(n.corrected(0))}" for n in unmet]
    for need in unmet:  # writing the present value changes nothing; a refusal shows a read-only object
        value = it.values[need.index, need.sub]
        if (abort := (yield from objects.write(it.name, need, value))) in _REFUSALS:
            raise objects.refused(it.name, need, value, abort)
    for pdos in (it.rpdos, it.tpdos):
        yield from _try_mappings(it, pdos)
    for wanted, present in it.rpdos + it.tpdos:
        if not present.fits(wanted):
            index = present.parameters
            changes.append(f"{index:04X}h and {index + 0x200:04X}h ({pdo_words(index)})")
    found = yield from errors.read(it.name, it.quirk.ignored_errors)
    told = found.words() if found.register else "error register 00h"
    if found.lost(None):
        told = f"error register {found.register:02X}h (it has lost its last master, as after the end of an executor)"
    elif found.open:
        told += f"; it has lost its last master, so {_UNDECIDED}"
    text = f"device type {kind:08X}h, {told}"
    if changes:
        text += f"; to be written: {'; '.join(changes[:_MOST_CHANGES])}"
        text += f"; and {len(changes) - _MOST_CHANGES} more" * (len(changes) > _MOST_CHANGES)
    text = "; ".join([text, *it.warnings])
    if found.register and not found.lost(None) and not found.open:
        texts[node] = CheckedBoard(board.name, text, "board-error")
    else:
        texts[node] = CheckedBoard(board.name, f"{'may' if found.open else 'can'} be booted: {text}")


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
    if (abort := (yield from objects.write(it.name, need, present.entries))) in _REFUSALS:
        text = f"board {it.name}: {why}; it refuses another mapping: {objects.abort_words(abort)}"
        raise BoardError(ArmFault("sdo-refused", it.name, text))
