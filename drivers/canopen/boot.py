"""Boot of one board without switching an output: find, check, configure, start, read back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.canopen import configuration, objects
from drivers.canopen.board import Board
from drivers.canopen.cia301 import NO_REMOTE, Command, State
from drivers.canopen.configuration import OnLoss
from drivers.canopen.device_type import check_type
from drivers.canopen.faults import Fault
from drivers.canopen.outputs import Outputs
from drivers.canopen.procedure import Ask, BoardError, Order, Procedure, Wait
from drivers.canopen.sdo import TIMEOUT, Transfer
from drivers.canopen.wiring import Timing


@dataclass
class Boot:
    """The boot of one board.

    Attributes:
        board: the board.
        outputs: takes the outputs that are read back.
        timing: heartbeats and boot time.
        on_loss: what the outputs do if the master is no longer heard.
    """

    board: Board
    outputs: Outputs
    timing: Timing
    on_loss: OnLoss


def boot(it: Boot) -> Procedure:
    """Boots a board; a board that is operational and rightly configured is left alone."""
    for step in _STEPS:
        yield from step(it)


def _find(it: Boot) -> Procedure:
    """Asks for the device type until the board answers."""
    board, patience = it.board, it.timing.boot_timeout
    before, kind, ordered = board.frames, None, False

    def stopped() -> bool:  # then it answers no SDO
        return board.state is State.STOPPED and not ordered

    for _ in range(1 + math.ceil(patience / TIMEOUT)):
        outcome = yield Ask(Transfer(0x1000, 0, tries=1), unless=stopped)
        if outcome.silence is None:
            kind = objects.number(board.name, 0x1000, 0, 4, outcome)
            break
        if stopped():
            yield from _order(it, Command.PRE_OPERATIONAL)
            ordered = True
    if kind is not None:
        check_type(board.layout, kind)
        return
    text = f"board {board.name} neither booted nor answered within {patience:g} s: is it powered?"
    if board.frames > before:
        text = f"board {board.name} is heard, but does not answer to 1000h sub 0 within {patience:g} s"
    raise BoardError(Fault("board-missing", board.name, text))


def _learn_state(it: Boot) -> Procedure:
    """Waits for a heartbeat of a board that has only answered so far, if it sends heartbeats."""
    board = it.board
    if board.state is None:
        period = (yield from objects.read(board.name, 0x1017, 0, size=2)) / 1000
        yield Wait(lambda: board.state is not None, min(2 * period, it.timing.boot_timeout))


def _configure(it: Boot) -> Procedure:
    """Configures and starts the board, unless it is operational and configured."""
    board, name = it.board, it.board.name
    no_remote = 0
    if board.layout.tpdo is not None:
        no_remote = (yield from objects.read(name, board.layout.tpdo.parameters, 1, size=4)) & NO_REMOTE
    entries = configuration.communication(board.layout, it.timing, it.on_loss, no_remote)
    if board.state is State.OPERATIONAL:
        expected = configuration.final(entries) + configuration.error_mode(board.layout, it.on_loss)
        for entry in expected:
            if not (yield from objects.holds(name, entry)):
                break
        else:
            board.state = None  # it may have left operational since its last heartbeat
            return
    # Some boards apply 6207h already on entering pre-operational: the outputs hold until all is configured.
    for entry in configuration.hold(board.layout):
        yield from objects.write(name, entry)
    if board.state is not State.PRE_OPERATIONAL:
        yield from _order(it, Command.PRE_OPERATIONAL)
    for entry in entries:
        yield from objects.write(name, entry)
    board.state = None  # an older heartbeat must not count as the answer
    yield from _order(it, Command.START)


def _await_operational(it: Boot) -> Procedure:
    """Waits for the board to be operational; configures it once more if it fell back.

    It may have missed the heartbeat of the master before just now, and left operational because of it.
    """
    board, patience = it.board, it.timing.boot_timeout
    up = Wait(lambda: board.state is State.OPERATIONAL, 3 * it.timing.heartbeat)
    if (yield up).data is not None:
        return
    if board.state is State.STOPPED:
        yield from _order(it, Command.PRE_OPERATIONAL)
    if board.state in (State.STOPPED, State.PRE_OPERATIONAL):
        yield from _configure(it)
    if (yield Wait(up.until, patience)).data is None:
        seen = "no heartbeat came" if board.state is None else f"it is {board.state.words}"
        text = f"board {board.name} did not become operational within {patience:g} s; {seen}"
        raise BoardError(Fault("board-stopped", board.name, text))


def _set_error_mode(it: Boot) -> Procedure:
    """Writes the error mode; until here the outputs were to hold."""
    if it.on_loss != "hold":
        for entry in configuration.error_mode(it.board.layout, it.on_loss):
            yield from objects.write(it.board.name, entry)


def _read_back(it: Boot) -> Procedure:
    """Adopts the outputs and inputs as they are."""
    board, layout = it.board, it.board.layout
    outputs, inputs = b"", dict[int, int]()
    for sub in layout.outputs:
        outputs += bytes([(yield from objects.read(board.name, 0x6200, sub))])
    before = board.input_frames
    for sub in layout.inputs:
        inputs[sub] = yield from objects.read(board.name, 0x6000, sub)
    if board.state is not State.OPERATIONAL:
        left = "its state is unknown" if board.state is None else f"it is {board.state.words}"
        raise BoardError(
            Fault("board-stopped", board.name, f"board {board.name} left operational while booting; {left}")
        )
    it.outputs.adopt(layout, outputs)
    if board.input_frames == before:  # otherwise a TPDO brought newer ones
        for sub, value in inputs.items():
            board.set_input(sub, value)
    board.ready = True


def _order(it: Boot, command: Command) -> Procedure:
    if (yield Order(command)).data is None:
        name, bus = it.board.name, it.board.layout.bus
        text = f"board {name} could not be told to change its state: {bus} takes no frames"
        raise BoardError(Fault("board-missing", name, text))


_STEPS: tuple[Callable[[Boot], Procedure], ...] = (
    _find,
    _learn_state,
    _configure,
    _await_operational,
    _set_error_mode,
    _read_back,
)
