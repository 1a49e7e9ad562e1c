"""Boot of one board without switching an output: find, inspect, configure, start, read back."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass

from drivers.canopen import configuration, inspection, objects, pdo_search
from drivers.canopen.board import Board
from drivers.canopen.cia301 import INVALID, Command, State
from drivers.canopen.faults import Fault
from drivers.canopen.inspection import Inspection
from drivers.canopen.layout import BoardLayout
from drivers.canopen.objects import Need
from drivers.canopen.outputs import Outputs
from drivers.canopen.pdo import INPUTS, Pdo, subs_of, union
from drivers.canopen.procedure import Ask, BoardError, Order, Procedure, Step, Wait
from drivers.canopen.sdo import TIMEOUT, Outcome, Transfer
from drivers.canopen.wiring import ErrorState, Timing

_ERROR_PATIENCE = 0.5  # [s] for a standing error to end once the board hears the master


@dataclass
class Boot:
    """The boot of one board.

    Attributes:
        index: of the board.
        board: the board.
        outputs: takes the outputs that are read back.
        timing: heartbeats and boot time.
        error_state: what a person knows of boards without an error mode.
        it: what is read of the board.
        kind: its device type.
        found: its state as it was found.
    """

    index: int
    board: Board
    outputs: Outputs
    timing: Timing
    error_state: ErrorState | None
    it: Inspection
    kind: int = 0
    found: State | None = None


def boot_board(index: int, board: Board, outputs: Outputs, timing: Timing, error_state: ErrorState | None) -> Procedure:
    """Boots a board; a board that is operational and rightly configured is left alone."""
    it = Inspection(board.layout)
    boot = Boot(index, board, outputs, timing, error_state, it)
    for step in _STEPS:
        yield from step(boot)


def find(layout: BoardLayout, patience: float, board: Board | None) -> Generator[Step, Outcome, tuple[int, bool]]:
    """Asks for the device type until the board answers; returns it, and whether the board was stopped before.

    Args:
        layout: of the board.
        patience: longest time for it to answer [s].
        board: what is heard of it; None if it is not listened to.
    """
    name, kind, ordered = layout.name, None, False
    before = 0 if board is None else board.frames

    def stopped() -> bool:  # then it answers no SDO
        return board is not None and board.state is State.STOPPED and not ordered

    for _ in range(1 + math.ceil(patience / TIMEOUT)):
        outcome = yield Ask(Transfer(0x1000, 0, tries=1), unless=stopped)
        if outcome.silence is None:
            kind = objects.number(name, 0x1000, 0, 4, outcome)
            break
        if stopped():
            yield from _order(layout, Command.PRE_OPERATIONAL)
            ordered = True
    if kind is not None:
        return kind, ordered
    text = f"board {name} neither booted nor answered within {patience:g} s: is it powered?"
    if board is not None and board.frames > before:
        text = f"board {name} is heard, but does not answer to 1000h sub 0 within {patience:g} s"
    raise BoardError(Fault("board-missing", name, text))


def _find(boot: Boot) -> Procedure:
    boot.kind, stopped = yield from find(boot.board.layout, boot.timing.boot_timeout, boot.board)
    boot.found = State.STOPPED if stopped else None


def _inspect(boot: Boot) -> Procedure:
    """Reads what the board is and holds."""
    it = boot.it
    yield from inspection.inspect(it, boot.kind, boot.timing, boot.error_state)
    board = boot.board
    yield from _learn_state(boot)
    boot.found = boot.found or board.state
    yield from pdo_search.read_pdos(it, in_full=board.state is State.OPERATIONAL)


def _learn_state(boot: Boot) -> Procedure:
    """Waits for a heartbeat, or an answer to node guarding, of a board that has only answered to SDO so far."""
    board, it, timing = boot.board, boot.it, boot.timing
    period = it.held.get((0x1017, 0), 0) / 1000
    if it.guarded:
        ours = not it.unmet(configuration.guarding(timing)) and not period
        period = timing.heartbeat if ours else 0.0
        if ours and not board.guarded:
            board.guard()
    elif period:
        board.guarded = False
    if board.state is None and period:
        yield Wait(lambda: board.state is not None, min(2 * period, timing.boot_timeout))


def _configure(boot: Boot) -> Procedure:
    """Configures and starts the board, unless it is operational and configured."""
    board, it = boot.board, boot.it
    if board.state is State.OPERATIONAL:
        yield from pdo_search.ask_for_sync(it)
        wrong = it.unmet(it.needs) + it.unmet(it.error_mode)
        if not wrong and pdo_search.as_is(it):
            board.state = None  # it may have left operational since its last heartbeat
            return
    if board.state in (State.OPERATIONAL, None):
        yield from _hold(it)
    if board.state is not State.PRE_OPERATIONAL:
        yield from _order(board.layout, Command.PRE_OPERATIONAL)
    yield from inspection.settle(it, it.needs)
    for pdos in (it.rpdos, it.tpdos):
        yield from pdo_search.set_up_pdos(it, pdos)
    if not board.layout.loss[0]:
        yield from inspection.settle(it, it.error_mode)
    yield from _release(boot)
    board.guarded = False
    if it.guarded:
        board.guard()
    board.state = None  # an older heartbeat must not count as the answer
    yield from _order(board.layout, Command.START)


def _hold(it: Inspection) -> Procedure:
    """Has the outputs hold until all is configured: some boards apply 6207h already on entering pre-operational.

    A board that does not take this may be right all the same: whether the final error mode is taken decides.
    """
    for need in it.unmet(configuration.held(it.layout)):
        place = need.index, need.sub
        yield from objects.write(it.name, need, need.corrected(it.held[place]))
        it.held[place] = yield from objects.read(it.name, *place, fresh=True)


def _release(boot: Boot) -> Procedure:
    """Switches off the outputs that a board may have switched off itself, so that its start energises nothing.

    A board that lost its master has applied its error mode. It may still hold the values of before in 6200h, and switch
    them again when it is started.
    """
    board, it, layout = boot.board, boot.it, boot.board.layout
    if it.has_error_mode:  # boards with a loss level stop when they lose the master, by 1029h
        loss, levels = layout.loss if boot.found is State.STOPPED else (0, 0)
        bits = union(b.place for b in layout.outputs if loss & b.place and b.inverted == bool(levels & b.place))
    else:
        bits = layout.output_bits
        if (layout.settings.error_state or boot.error_state) == "hold" or not (yield from _lost_master(boot)):
            bits = 0
    off = union(b.place for b in layout.outputs if b.inverted)
    for sub in subs_of(bits):
        mask, value = (number >> 8 * (sub - 1) & 0xFF for number in (bits, off))
        need = Need(layout.settings.object, sub, value & mask, 1, "outputs", mask=mask)
        held = yield from objects.read(board.name, need.index, sub)
        if not need.met(held):
            yield from objects.settle(board.name, need, held)


def _lost_master(boot: Boot) -> Generator[Step, Outcome, bool]:
    """Returns whether a board is out of operational because it lost the master, and not by an order."""
    if boot.found not in (State.STOPPED, State.PRE_OPERATIONAL):
        return False
    newest = yield from objects.find(boot.board.name, 0x1003, 1, 4)
    return (newest or 0) & 0xFFFF == inspection.MASTER_LOST


def _await_operational(boot: Boot) -> Procedure:
    """Waits for the board to be operational; configures it once more if it fell back.

    It may have missed the heartbeat of the master before just now, and left operational because of it.
    """
    board, patience = boot.board, boot.timing.boot_timeout
    up = Wait(lambda: board.state is State.OPERATIONAL, 3 * boot.timing.heartbeat)
    if (yield up).data is not None:
        return
    if board.state is State.STOPPED:
        yield from _order(board.layout, Command.PRE_OPERATIONAL)
    if board.state in (State.STOPPED, State.PRE_OPERATIONAL):
        yield from _configure(boot)
    if (yield Wait(up.until, patience)).data is None:
        seen = "no heartbeat came" if board.state is None else f"it is {board.state.words}"
        text = f"board {board.name} did not become operational within {patience:g} s; {seen}"
        if board.state is not State.STOPPED:
            _, why, _ = yield from inspection.read_errors(boot.it, board)
            text += f"; {why}" if why else ""
        raise BoardError(Fault("board-stopped", board.name, text))


def _set_error_mode(boot: Boot) -> Procedure:
    """Writes the error mode; until here the outputs were to hold."""
    yield from inspection.settle(boot.it, boot.it.error_mode)


def _check_errors(boot: Boot) -> Procedure:
    """Refuses a board with a standing error; one that ends because the board hears the master is waited for."""
    board, it = boot.board, boot.it
    for _ in range(6):
        register, text, lost = yield from inspection.read_errors(it, board)
        if not register:
            return
        yield Wait(lambda: False, _ERROR_PATIENCE / 5)
    if not lost:
        text = f"board {board.name} reports an error: {text}. Remove its cause, then reset"
        raise BoardError(Fault("board-error", board.name, text))
    it.warn(f"it keeps an error of the time before this start: {text}")
    it.kept_errors = register


def _read_back(boot: Boot) -> Procedure:
    """Adopts the outputs and inputs as they are."""
    board, it, inputs = boot.board, boot.it, dict[int, int]()
    rpdos, tpdos = pdo_search.adopt(it)
    values = dict[int, int]()
    for entry in {entry for pdo in rpdos for entry in pdo.mapping if entry >> 16 > 7}:
        values[entry] = yield from _value(board, entry)
    board.take_inputs_from(tpdos)
    before = board.input_frames
    for sub in subs_of(board.layout.input_bits):
        inputs[sub] = yield from objects.read(board.name, INPUTS, sub)
    if board.state is not State.OPERATIONAL:
        left = "its state is unknown" if board.state is None else f"it is {board.state.words}"
        raise BoardError(
            Fault("board-stopped", board.name, f"board {board.name} left operational while booting; {left}")
        )
    boot.outputs.adopt(boot.index, rpdos, values)
    if board.input_frames == before:  # otherwise a TPDO brought newer ones
        for sub, value in inputs.items():
            board.set_input(sub, value)
    board.warnings, board.ignored_errors = tuple(it.warnings), it.quirk.ignored_errors | it.kept_errors
    board.expected = _expected(it, rpdos + tpdos)
    board.ready = True


def _value(board: Board, entry: int) -> Generator[Step, Outcome, int]:
    """Reads an object that an RPDO carries; one that is no used output may be missing or unreadable."""
    index, sub, count = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
    size = (count + 7) // 8
    if index == board.layout.settings.object and board.layout.output_bits >> 8 * (sub - 1) & 0xFF:
        return (yield from objects.read(board.name, index, sub))
    outcome = yield Transfer(index, sub)
    return int.from_bytes((outcome.data or b"")[:size], "little")


def _expected(it: Inspection, pdos: tuple[Pdo, ...]) -> tuple[Need, ...]:
    """Returns what the board holds, so that a later change is noticed."""
    needs = {(n.index, n.sub): n for n in (*it.needs, *it.error_mode) if (n.index, n.sub) in it.held}
    for _, held in (*it.rpdos, *it.tpdos):
        index, mapping = held.parameters, held.mapping
        needs[index, 1] = Need(index, 1, held.cob_id & ~INVALID, 4, "COB-ID", mask=INVALID | 0x7FF)
        needs[index, 2] = Need(index, 2, held.kind, 1, "transmission type")
        needs[index + 0x200, 0] = Need(index + 0x200, 0, len(mapping), 1, "number of mapped objects")
        needs |= {
            (index + 0x200, 1 + i): Need(index + 0x200, 1 + i, entry, 4, "mapped object")
            for i, entry in enumerate(mapping)
        }
    return tuple(needs.values())


def _order(layout: BoardLayout, command: Command) -> Procedure:
    if (yield Order(command)).data is None:
        text = f"board {layout.name} could not be told to change its state: {layout.bus} takes no frames"
        raise BoardError(Fault("board-missing", layout.name, text))


_STEPS: tuple[Callable[[Boot], Procedure], ...] = (
    _find,
    _inspect,
    _configure,
    _await_operational,
    _set_error_mode,
    _check_errors,
    _read_back,
)
