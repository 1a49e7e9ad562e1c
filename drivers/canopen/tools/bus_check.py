"""Checks each board of a wiring by the steps of the boot, and changes no value on it (`check --bus`)."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

from hyperbit.drivers.canopen.boot.board_boot import configure, find
from hyperbit.drivers.canopen.boot.inspection import Inspection, inspect
from hyperbit.drivers.canopen.boot.pdo_search import find_pdos
from hyperbit.drivers.canopen.boot.pdo_state import pdo_words
from hyperbit.drivers.canopen.layout import BoardLayout, lay_out
from hyperbit.drivers.canopen.sdo import errors
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.objects import BUSY, READ_ONLY, Place
from hyperbit.drivers.canopen.sdo.procedure import Ask, BoardError, Procedure, Step
from hyperbit.drivers.canopen.tools.session import Node, Session, stopped
from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.canopen.wiring import Timing, Wiring

_BOARD_TIMEOUT = 1.0  # [s] for the first answer of a board
_REFUSALS = (READ_ONLY, BUSY)  # of the present value: `run` could not write another one
_UNDECIDED = "only run can tell whether it can be booted"
_MOST_CHANGES = 4  # changes that the answer lists


@dataclass(frozen=True)
class CheckedBoard:
    board: str  # name, e.g. "can0/5"
    text: str  # device type, values that the boot will write, and limits; or the fault
    code: str = ""  # code of the fault; "": the board can be booted and reports no error


class _Unchanged(Dictionary):
    """Writes the present value in place of a new one, to find read-only objects; later reads see the new one."""

    def __init__(self, board: str, patience: float) -> None:
        super().__init__(board, patience)
        self.would = dict[Place, bytes]()  # values that a boot would have written

    def transfer(self, step: Transfer | Ask) -> Generator[Step, SdoOutcome, SdoOutcome]:
        it = step.transfer if isinstance(step, Ask) else step
        if it.data is None:
            if it.place in self.would:
                return SdoOutcome(data=self.would[it.place])
            return (yield from super().transfer(step))
        if it.place in self.values and it.place not in self.would:
            present = self.values[it.place].to_bytes(len(it.data), "little")
            outcome = yield from super().transfer(replace(it, data=present))
            if outcome.silence is not None or outcome.abort in _REFUSALS:
                return outcome
        self.would[it.place] = it.data
        return SdoOutcome(data=b"")


def check_bus(session: Session, wiring: Wiring, timing: Timing) -> list[CheckedBoard]:
    """Asks all boards in parallel; returns their answers, after that of each bus that cannot be used.

    The check writes only values that the objects have already, to find read-only objects. So neither a lost frame nor
    the end of the process leaves another value on a board. Raises MasterHeard.
    """
    boards = {(board.bus, board.node): board for board in lay_out(wiring).boards}
    texts: dict[Node, CheckedBoard] = {}
    faults = session.run({node: _inspect(session, board, timing, texts) for node, board in boards.items()})
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


def _inspect(session: Session, board: BoardLayout, timing: Timing, texts: dict[Node, CheckedBoard]) -> Procedure:
    node, objects = (board.bus, board.node), _Unchanged(board.name, timing.boot_timeout)
    try:
        yield from find(objects, _BOARD_TIMEOUT, None)
    except BoardError as error:
        if error.fault.code != "board-missing":
            raise
        yield from session.poll_state(node)  # it may send heartbeats, or answer a remote frame
        if (state := session.states.get(node)) is None:
            raise
        if state is State.STOPPED:
            objects.refuse("board-stopped", f"{stopped(board.name)}; {_UNDECIDED}")
        text = f"board {board.name} is {state.words}, but does not answer to 1000h sub 0 within {_BOARD_TIMEOUT:g} s"
        objects.refuse("board-missing", text)
    it = Inspection(board, objects, timing)
    yield from inspect(it)
    yield from find_pdos(it, in_full=True)
    unmet = objects.unmet(it.needs) + objects.unmet(it.error_mode)
    changes = [f"{n.place} {n.words(objects.values[n.at])} -> {n.words(n.corrected(0))}" for n in unmet]
    yield from configure(it)
    yield from objects.meet(it.error_mode)
    written = {index for index, _ in objects.would}
    pdos = (wanted.parameters for wanted in it.rpdos + it.tpdos)
    changes += (f"{k:04X}h and {k + 0x200:04X}h ({pdo_words(k)})" for k in pdos if written & {k, k + 0x200})
    found = yield from errors.read(objects, it.quirk.ignored_errors)
    told = found.words() if found.register else "error register 00h"
    if found.lost(None):
        told = f"error register {found.register:02X}h (it has lost its last master, as after the end of an executor)"
    elif found.open:
        told += f"; it has lost its last master, so {_UNDECIDED}"
    text = f"device type {objects.values[0x1000, 0]:08X}h, {told}"
    if changes:
        text += f"; to be written: {'; '.join(changes[:_MOST_CHANGES])}"
        text += f"; and {len(changes) - _MOST_CHANGES} more" * (len(changes) > _MOST_CHANGES)
    text = "; ".join([text, *it.warnings])
    if found.register and not found.lost(None) and not found.open:
        texts[node] = CheckedBoard(board.name, text, "board-error")
    else:
        texts[node] = CheckedBoard(board.name, f"{'may' if found.open else 'can'} be booted: {text}")
