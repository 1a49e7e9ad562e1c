"""Reads the inputs of all boards again in turn, so that a lost TPDO is noticed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hyperbit.drivers.canopen.pdo import subs_of
from hyperbit.drivers.canopen.run.board import Station
from hyperbit.drivers.canopen.wire.cia301 import wire_bits
from hyperbit.drivers.canopen.wire.link import Link

_READ_EVERY = 1.5  # [s] between two reads of a board; with the answer, a lost TPDO is noticed within 2 s
_SHARE = 0.01  # of the bit rate, for boards without interlocks


class InputWatch:
    """Asks each ready board for its inputs, 6000h, by SDO. A TPDO that comes before the answer is newer, and wins.

    A board with an interlock is asked every 1.5 s. 126 such boards with one byte each take 126 x 2 x 135 bits in 1.5 s:
    22.7 kbit/s, 18 % of 125 kbit/s. Other boards are asked as often, but with 1 % of the bit rate at most.

    Args:
        stations: all boards.
        links: all buses.
        interlocks: mask of the input lines of interlocks.
    """

    def __init__(self, stations: Sequence[Station], links: Iterable[Link], interlocks: int) -> None:
        self._stations = [station for station in stations if station.board.layout.inputs]
        self._periods: dict[int, float] = {}
        for link in links:
            here = [s for s in self._stations if s.board.layout.bus == link.name]
            guards = {s.index for s in here if any(bit.line & interlocks for bit in s.board.layout.inputs)}
            transfers = sum(len(subs_of(s.board.layout.input_bits)) for s in here if s.index not in guards)
            shared = transfers * 2 * wire_bits(8) / (_SHARE * link.wiring.bitrate)
            self._periods |= {s.index: _READ_EVERY if s.index in guards else max(_READ_EVERY, shared) for s in here}
        self._due: dict[int, float] = {}

    def begin(self, now: float) -> None:
        """Records that a boot has begun, which reads all inputs; the reads after it are spread over their periods."""
        count = len(self._stations)
        self._due = {s.index: now + self._periods[s.index] * (i + 1) / count for i, s in enumerate(self._stations)}

    def tick(self, now: float) -> None:
        """Asks the boards that are due; a board with a running procedure is asked after it. Call every period."""
        for station in self._stations:
            if now >= self._due.get(station.index, now) and station.board.ready and not station.runner.running:
                self._due[station.index] = now + self._periods[station.index]
                station.question(now)

    def hurry(self, bus: str, now: float) -> None:
        """Has all ready boards of a bus asked at the next tick: their TPDOs may be lost."""
        for station in self._stations:
            if station.board.layout.bus == bus:
                self._due[station.index] = now
