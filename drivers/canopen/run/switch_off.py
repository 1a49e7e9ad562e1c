"""Switches lines off by SDO, where an RPDO would also carry outputs that nobody knows."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.drivers.canopen.boards.board import Board
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.pdo import subs_of, union
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import BoardError, Procedure, Wait
from hyperbit.drivers.canopen.wire.cia301 import State


def switch_off(
    board: Board, outputs: OutputLines, lines: int, told_within: float, switched: Callable[[int], None]
) -> Procedure:
    """Reads each output byte with some of the lines, writes it directly after that with these bits off, and reads it.

    A board that is not ready must tell within a time [s] that it is operational: in another state its pins may differ
    from 6200h, and its pulses are off. A byte with other bits on is written in two steps, as in a boot. `switched`
    takes the mask of the lines that were on.
    """
    if not board.ready:
        board.state = None
        yield Wait(lambda: board.state is not None, told_within)
        if board.state is not State.OPERATIONAL:
            return
    index, it = board.layout.settings.object, Dictionary(board.name)
    for sub in subs_of(union(bit.place for bit in board.layout.outputs if bit.line & lines)):
        here = [bit for bit in board.layout.outputs if bit.line & lines and bit.place >> 8 * (sub - 1) & 0xFF]
        off = union(bit.place for bit in here if bit.inverted) >> 8 * (sub - 1)
        mask = union(bit.place for bit in here) >> 8 * (sub - 1)
        need = Need(index, sub, off, 1, "outputs", mask=mask)
        for staged in (True, False):  # not each board takes a write in two steps
            outputs.begin_read(board.index)
            present = yield from it.read(index, sub, fresh=True)
            if board.ready:
                outputs.read(board.index, sub, present)
            if need.met(present):
                break
            staged = staged and need.corrected(present) != 0
            try:
                yield from it.ensure(need, staged)
                break
            except BoardError:
                if not staged:
                    raise
        switched(outputs.written_off(union(bit.line for bit in here)))
