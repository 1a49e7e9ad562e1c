"""Reads the inputs of all boards again in turn, so that a lost TPDO is noticed."""

from __future__ import annotations

from collections.abc import Iterable

from hyperbit.drivers.canopen.pdo import subs_of
from hyperbit.drivers.canopen.run.board import Board
from hyperbit.drivers.canopen.wire.cia301 import wire_bits
from hyperbit.drivers.canopen.wire.link import Link

_READ_EVERY = 1.5  # [s] between two reads of a board; with the answer, a lost TPDO is noticed within 2 s
_SHARE = 0.01  # of the bit rate, for boards without interlocks


class InputWatch:
    """Asks each ready board for its inputs, 6000h, by SDO. A TPDO that comes before the answer is newer, and wins.

    A board with an input line of `interlocks` is asked every 1.5 s. 126 such boards with one byte each take
    126 x 2 x 135 bits in 1.5 s: 22.7 kbit/s, 18 % of 125 kbit/s. Other boards are asked as often, but with 1 % of the
    bit rate at most.
    """

    def __init__(self, boards: Iterable[Board], links: Iterable[Link], interlocks: int) -> None:
        self._boards = [board for board in boards if board.layout.inputs]
        self._periods: dict[int, float] = {}
        for link in links:
            here = [b for b in self._boards if b.link is link]
            guards = {b.index for b in here if b.layout.input_lines & interlocks}
            transfers = sum(len(subs_of(b.layout.input_bits)) for b in here if b.index not in guards)
            shared = transfers * 2 * wire_bits(8) / (_SHARE * link.wiring.bitrate)
            self._periods |= {b.index: _READ_EVERY if b.index in guards else max(_READ_EVERY, shared) for b in here}
        self._due: dict[int, float] = {}

    def begin(self, now: float) -> None:
        """Records that a boot has begun, which reads all inputs; the reads after it are spread over their periods."""
        count = len(self._boards)
        self._due = {b.index: now + self._periods[b.index] * (k + 1) / count for k, b in enumerate(self._boards)}

    def tick(self, now: float) -> None:
        """Asks the boards that are due; a board with a running procedure is asked after it. Call every period."""
        for board in self._boards:
            if now >= self._due.get(board.index, now) and board.ready and not board.runner.running:
                self._due[board.index] = now + self._periods[board.index]
                board.question(now)

    def hurry(self, bus: str, now: float) -> None:
        """Has all ready boards of a bus asked at the next tick: their TPDOs may be lost."""
        self._due |= {board.index: now for board in self._boards if board.link.name == bus}
