"""The boot of one board: find, inspect, configure, start, read back. It switches no output."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass

from hyperbit.drivers.canopen.boards.board import Board
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.boot import board_needs, pdo_search
from hyperbit.drivers.canopen.boot.inspection import Inspection, inspect
from hyperbit.drivers.canopen.boot.pdo_setup import set_up_pdos
from hyperbit.drivers.canopen.boot.pdo_state import pdo_state
from hyperbit.drivers.canopen.boot.pins import settle
from hyperbit.drivers.canopen.faults import board_error, left_operational, remedy
from hyperbit.drivers.canopen.pdo import INPUTS, Pdo, carries, subs_of
from hyperbit.drivers.canopen.sdo import errors
from hyperbit.drivers.canopen.sdo.client import SDO_TIMEOUT, SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.objects import Need, Place
from hyperbit.drivers.canopen.sdo.procedure import Ask, BoardError, Procedure, Step, Wait
from hyperbit.drivers.canopen.wire.cia301 import INVALID, Command, State
from hyperbit.drivers.canopen.wiring import Timing

_LAST_DUMMY = 7  # 0001h to 0007h are dummy entries (CiA 301, 7.4.7)
_TELL_STATE = (0x100C, 0x100D, 0x1017)
_MOST_STOPS = 3  # attempts of one boot: the loss of an earlier master, or another program, may stop the board
_ERROR_TIMEOUT = 0.5  # [s] in which an error may end after the board hears the master


@dataclass
class Boot:
    board: Board
    outputs: OutputLines  # take the levels that are read back
    it: Inspection
    stopped: bool = False  # found stopped, and not started since


def boot_board(board: Board, outputs: OutputLines, timing: Timing) -> Procedure:
    """Boots a board. Writes nothing to an operational board with the right configuration.

    A board that stops during its boot, and answers no longer, is booted again. A refused board gets its objects and its
    NMT state back, except outputs that were written off.
    """
    objects = Dictionary(board.name, timing.boot_timeout, spared=board.layout.settings.object)
    for stops_left in reversed(range(_MOST_STOPS)):
        boot = Boot(board, outputs, Inspection(board.layout, objects, timing))
        try:
            for step in _STEPS:
                yield from step(boot)
            return
        except BoardError as error:
            if error.fault.code != "board-missing":  # node guarding continues, so that its outputs stay unchanged
                yield from objects.undo()
                raise
            if objects.values:  # the board may have stopped after its last state, and answer only node guarding
                board.state = None
                board.guard()
                yield Wait(lambda: board.state is not None, 2 * timing.heartbeat)
                if board.stopped and stops_left:  # polls continue: the first one has started the board's life time
                    objects.forget()
                    continue
            board.guarded = False
            raise


def find(objects: Dictionary, timeout: float, board: Board | None) -> Generator[Step, SdoOutcome, bool]:
    """Reads the device type, 1000h, until the board answers; returns whether the board was in state stopped.

    It waits up to `timeout` [s]. `board` records the board's frames; None: nobody listens.
    """
    ordered = False
    before = 0 if board is None else board.frames

    def stopped() -> bool:  # a stopped board answers no SDO
        return board is not None and board.state is State.STOPPED and not ordered

    tries = 1 + math.ceil(timeout / SDO_TIMEOUT)
    while tries:
        tries -= 1
        outcome = yield from objects.transfer(Ask(Transfer(0x1000, 0, tries=1), unless=stopped))
        if outcome.silence is None:
            objects.take(0x1000, 0, 4, outcome)
            return ordered
        if stopped():
            yield from objects.order(Command.PRE_OPERATIONAL, State.STOPPED)
            ordered = True
            tries += 1  # also after the time-out: now it can answer
        elif board is not None and board.frames == before and not board.guarded:
            board.guard()  # a stopped board without heartbeats answers only the remote frames of node guarding
    text = f"board {objects.board} neither booted nor answered within {timeout:g} s: is it powered?"
    if board is not None and board.frames > before:
        text = f"board {objects.board} is heard, but does not answer to 1000h sub 0 within {timeout:g} s"
    objects.refuse("board-missing", text)
    return ordered


def _find(boot: Boot) -> Procedure:
    boot.stopped = yield from find(boot.it.objects, boot.it.timing.boot_timeout, boot.board)


def _inspect(boot: Boot) -> Procedure:
    """Reads identity, configuration and PDOs of the board; writes nothing."""
    yield from inspect(boot.it)
    yield from _learn_state(boot)
    yield from pdo_search.find_pdos(boot.it, in_full=boot.board.state is State.OPERATIONAL)


def _learn_state(boot: Boot) -> Procedure:
    """Waits for the NMT state: for a heartbeat or an answer to node guarding."""
    board, it, timing = boot.board, boot.it, boot.it.timing
    period = boot.it.objects.values.get((0x1017, 0), 0) / 1000
    if it.guarded:
        ours = not boot.it.objects.unmet(board_needs.guarding(timing)) and not period
        period = timing.heartbeat if ours else 0.0
        if ours and not board.guarded:
            board.guard()
    else:
        board.guarded = False
    if board.state is None and period:
        yield Wait(lambda: board.state is not None, min(2 * period, timing.boot_timeout))


def _told_state(boot: Boot) -> Generator[Step, SdoOutcome, State | None]:
    """Returns the NMT state that the board tells from now on; None: it tells none."""
    boot.board.state = None
    yield from _learn_state(boot)
    return boot.board.state


def _configure(boot: Boot) -> Procedure:
    """Configures and starts the board, unless it is operational with the right configuration."""
    board, it = boot.board, boot.it
    if board.state is State.OPERATIONAL:
        yield from pdo_search.ask_for_sync(it)
        wrong = boot.it.objects.unmet(it.needs) + boot.it.objects.unmet(it.error_mode)
        if not wrong and pdo_search.as_is(it):
            board.state = None  # its NMT state may have changed since its last heartbeat
            return
    if board.state is None:
        yield from _make_it_tell(boot)
    yield from _enter_pre_operational(boot)
    yield from _settle(boot)
    yield from configure(it)
    if not board.layout.loss[0]:
        yield from boot.it.objects.meet(it.error_mode)
    board.guarded = False
    if it.guarded:
        board.guard()
    board.state, boot.stopped = None, False  # an earlier heartbeat must not count
    yield from boot.it.objects.order(Command.START)


def configure(it: Inspection) -> Procedure:
    """Meets all needs but the error mode, and sets up the PDOs."""
    yield from it.objects.meet(it.needs)
    for pdos in (it.rpdos, it.tpdos):
        yield from set_up_pdos(it, pdos)


def _make_it_tell(boot: Boot) -> Procedure:
    """Configures heartbeats or node guarding of a board whose NMT state is unknown, and waits for the state."""
    yield from boot.it.objects.meet([need for need in boot.it.needs if need.index in _TELL_STATE])
    yield from _learn_state(boot)


def _settle(boot: Boot) -> Procedure:
    """Writes the outputs so that START changes no pin."""
    board, outputs = boot.board, boot.outputs
    held = outputs.bits(board.index) if board.held else None
    board.released |= yield from settle(boot.it, boot.stopped, held)
    boot.it.objects.pins_known = True


def _enter_pre_operational(boot: Boot) -> Procedure:
    """Enters pre-operational, in which the outputs hold.

    Some boards apply 6207h as soon as they enter pre-operational. So an operational board gets hold in 6206h before. If
    1029h keeps the board operational in its error state, this write switches the pins to 6200h; so 6200h is settled
    first. The board leaves that error state with the command only, so a lost command is sent again.
    """
    board, objects = boot.board, boot.it.objects
    if board.state is State.PRE_OPERATIONAL:
        return
    stays = not board_needs.leaves_operational(objects.values.get((0x1029, 1)))
    unsure = board.state is State.OPERATIONAL and board.held is None and stays
    if board.state is State.OPERATIONAL and (unmet := objects.unmet(board_needs.hold_outputs(board.layout))):
        before = {need.at: objects.values[need.at] for need in unmet}
        if unsure:
            yield from _settle(boot)
        yield from _write_error_mode(objects, dict.fromkeys(before, 0), unmet)
        state = yield from _told_state(boot)
        if not unsure and state is not State.OPERATIONAL:  # the board may have left operational before the write
            yield from _write_error_mode(objects, before, unmet)
    yield from objects.order(Command.PRE_OPERATIONAL, board.state)
    if unsure and (yield from _told_state(boot)) is State.OPERATIONAL:
        yield from boot.it.objects.order(Command.PRE_OPERATIONAL)


def _write_error_mode(objects: Dictionary, values: dict[Place, int], needs: list[Need]) -> Procedure:
    """Writes 6206h and reads it back.

    A board that does not accept a value may still be correct: the final value of 6206h decides.
    """
    for need in needs:
        value = objects.values[need.at] & ~need.mask | values[need.at] & need.mask
        yield from objects.write(*need.at, value & 0xFF, 1)
        yield from objects.read(*need.at, fresh=True)


def _await_operational(boot: Boot) -> Procedure:
    """Waits until the board is operational; configures it again if it leaves that state.

    A board leaves operational when it has just missed a heartbeat of the master.
    """
    board, timeout = boot.board, boot.it.timing.boot_timeout
    up = Wait(lambda: board.state is State.OPERATIONAL, 3 * boot.it.timing.heartbeat)
    if (yield up).data is not None:
        return
    if board.state is State.STOPPED:
        yield from boot.it.objects.order(Command.PRE_OPERATIONAL)
    if board.state in (State.STOPPED, State.PRE_OPERATIONAL):
        yield from _configure(boot)
    if (yield Wait(up.until, timeout)).data is None:
        seen = "no heartbeat came" if board.state is None else f"it is {board.state.words}"
        code, text = "board-stopped", f"board {board.name} did not become operational within {timeout:g} s; {seen}"
        if board.state is not State.STOPPED:
            found = yield from errors.read(boot.it.objects, boot.it.quirk.ignored_errors)
            if found.register:
                text += f"; {found.words(board.emergency)}. {remedy(board.name)}"
                code = code if found.lost(board.emergency) else "board-error"
        boot.it.objects.refuse(code, text)


def _set_error_mode(boot: Boot) -> Procedure:
    yield from boot.it.objects.meet(boot.it.error_mode)


def _check_errors(boot: Boot) -> Procedure:
    """Refuses a board with an error in 1001h. An error that reports the loss of the master may end within 0.5 s."""
    board, it = boot.board, boot.it
    for _ in range(6):
        register = yield from errors.read_register(it.objects, it.quirk.ignored_errors)
        if not register:
            board.emergency, board.emergency_register = None, 0  # the end of this emergency was missed
            return
        yield Wait(lambda: False, _ERROR_TIMEOUT / 5)
    found = yield from errors.read_history(it.objects, register)
    if not found.lost(board.emergency):
        fault = board_error(board.name, found.words(board.emergency))
        it.objects.refuse(fault.code, fault.message)
    it.warn(f"it keeps an error from before this boot: {found.words(board.emergency)}")
    it.kept = found


def _read_back(boot: Boot) -> Procedure:
    board, it = boot.board, boot.it
    rpdos, tpdos = pdo_search.adopt(it)
    values = yield from _carried_values(it, rpdos)
    board.set_tpdos(tpdos)
    for sub in subs_of(board.layout.input_bits):
        board.begin_input_read()
        board.set_input(sub, (yield from it.objects.read(INPUTS, sub)))
    yield from board.ask_watched()
    if board.state is not State.OPERATIONAL:
        seen = "its state is unknown" if board.state is None else f"it is {board.state.words}"
        text = left_operational(board.name, f"while booting; {seen}")
        it.objects.refuse("board-stopped", text)
    boot.outputs.adopt(board.index, rpdos, values)
    kept = it.kept.register if it.kept is not None else 0
    board.warnings, board.ignored_errors = tuple(it.warnings), it.quirk.ignored_errors | kept
    board.expected = _expected(it)
    board.beats.period = 0.0 if it.guarded else it.objects.values[0x1017, 0] / 1000
    if it.kept is not None and it.kept.history:  # a further error in these bits shows only as a new entry
        board.history = it.kept.history[0]
    board.ready = True


def _carried_values(it: Inspection, rpdos: Iterable[Pdo]) -> Generator[Step, SdoOutcome, dict[int, int]]:
    """Reads the values of RPDOs' mapped objects, by mapping entry; words and single bits of outputs as bytes.

    Raises BoardError if an object cannot be read: the RPDO would overwrite its unknown value.
    """
    base, bytes_read, values = it.layout.settings.object, dict[int, int](), dict[int, int]()
    for entry in {entry for pdo in rpdos for entry in pdo.mapping if entry >> 16 > _LAST_DUMMY}:
        index, sub, count = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        carried = carries((entry,), base)
        if not carried:
            values[entry] = yield from it.objects.read(index, sub, (count + 7) // 8)
            continue
        bit, _, width = carried[0]
        for byte in range(bit // 8, (bit + width + 7) // 8):
            if byte not in bytes_read:
                bytes_read[byte] = yield from it.objects.read(base, 1 + byte)
        whole = sum(value << 8 * byte for byte, value in bytes_read.items())
        values[entry] = whole >> bit & (1 << width) - 1
    return values


def _expected(it: Inspection) -> tuple[Need, ...]:
    """Returns the values of the board's objects after the boot; a later difference is a fault."""
    needs = {need.at: need for need in (*it.needs, *it.error_mode) if need.at in it.objects.values}
    for wanted in (*it.rpdos, *it.tpdos):
        present = pdo_state(it.objects, wanted.parameters)
        index, mapping = present.parameters, present.mapping
        needs[index, 1] = Need(index, 1, present.cob_id & ~INVALID, 4, "COB-ID", mask=INVALID | 0x7FF)
        needs[index, 2] = Need(index, 2, present.kind, 1, "transmission type")
        needs[index + 0x200, 0] = Need(index + 0x200, 0, len(mapping), 1, "number of mapped objects")
        needs |= {
            (index + 0x200, 1 + i): Need(index + 0x200, 1 + i, entry, 4, "mapped object")
            for i, entry in enumerate(mapping)
        }
    return tuple(needs.values())


_STEPS: tuple[Callable[[Boot], Procedure], ...] = (
    _find,
    _inspect,
    _configure,
    _await_operational,
    _set_error_mode,
    _check_errors,
    _read_back,
)
