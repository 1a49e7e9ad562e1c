"""Numbers in a board's object dictionary, read and written one at a time (SDO; CiA 301, 7.2.4)."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers import cia301
from drivers.bus import CanBus
from drivers.faults import BusBusy, Fault
from drivers.layout import Board

_T = TypeVar("_T")

_TIMEOUT = 0.5  # [s] for one answer
_TRIES = 2
_MOST_ANSWERS = 8  # frames in one transfer; a number takes one, or three in segments
_NO_OBJECT, _NO_SUB_INDEX = 0x0602_0000, 0x0609_0011

# An absent optional object is no error, and what is one is told as a fault: the library's own log would say it twice.
logging.getLogger("canopen.sdo").setLevel(logging.CRITICAL)


class BoardError(Exception):
    """A board cannot be brought up; `fault` says why."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.message)
        self.fault = fault


@dataclass(frozen=True)
class Entry:
    """A value of one object.

    Attributes:
        index: of the object.
        sub: sub-index.
        value: unsigned.
        size: [bytes].
        optional: the standard lets a board go without this object.
    """

    index: int
    sub: int
    value: int
    size: int = 1
    optional: bool = False


class Sdo:
    """One board's object dictionary.

    Args:
        board: the board.
        bus: its bus.
        network: fed with the SDO answers read from that bus.
    """

    def __init__(self, board: Board, bus: CanBus, network: canopen.Network) -> None:
        self._board = board
        request, answer = cia301.SDO_REQUEST + board.node, cia301.SDO_ANSWER + board.node
        self._client = SdoClient(request, answer, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]
        self._client.RESPONSE_TIMEOUT = _TIMEOUT
        self._client.network = network
        network.bus = bus  # type: ignore[assignment]  # of a bus, canopen uses nothing but send()
        network.subscribe(answer, self._hear)
        self._awaited = 0

    def read(self, index: int, sub: int, size: int = 1) -> int:
        """Reads an unsigned value of `size` bytes.

        Raises:
            BoardError: the board refuses, does not answer or not in that size, or the bus is busy.
        """
        try:
            return self._upload(index, sub, size)
        except SdoAbortedError as error:
            raise self._refused(f"to tell {index:04X}h sub {sub}", error) from error

    def write(self, entry: Entry) -> None:
        """Writes a value; an optional object that is absent is passed over.

        Raises:
            BoardError: the board refuses, does not answer, or the bus is busy.
        """
        data = entry.value.to_bytes(entry.size, "little")
        try:
            self._insist(entry.index, entry.sub, lambda: self._client.download(entry.index, entry.sub, data))
        except SdoAbortedError as error:
            if not _absent(entry, error):
                value = f"{entry.value:0{2 * entry.size}X}h"
                raise self._refused(f"{value} in {entry.index:04X}h sub {entry.sub}", error) from error

    def holds(self, entry: Entry) -> bool:
        """Whether the board has this value already; an optional object that is absent counts as right.

        Raises:
            BoardError: the board does not answer or not in the right size, or the bus is busy.
        """
        try:
            return self._upload(entry.index, entry.sub, entry.size) == entry.value
        except SdoAbortedError as error:
            return _absent(entry, error)

    def _hear(self, cob_id: int, data: bytearray, timestamp: float) -> None:
        """Hands an answer over while one is awaited: the client would keep what nobody asked for, and without end."""
        if self._awaited > 0:
            self._awaited -= 1
            self._client.on_response(cob_id, data, timestamp)  # type: ignore[no-untyped-call]

    def _upload(self, index: int, sub: int, size: int) -> int:
        data = self._insist(index, sub, lambda: self._client.upload(index, sub))
        if len(data) not in (size, 4):  # some boards send four bytes, whatever the number's size
            text = f"board {self._board.name} answers {len(data)} bytes to {index:04X}h sub {sub}; {size} are needed"
            raise BoardError(Fault("wrong-device", self._board.name, text))
        return int.from_bytes(data[:size], "little")

    def _insist(self, index: int, sub: int, transfer: Callable[[], _T]) -> _T:
        """Tries again when there is no answer, or a late one to an earlier question."""
        for _ in range(_TRIES):
            self._awaited = _MOST_ANSWERS
            try:
                return transfer()
            except (SdoCommunicationError, BusBusy, struct.error) as error:
                why = error
            finally:
                self._awaited = 0
        message = f"board {self._board.name} does not answer to {index:04X}h sub {sub}: {why}"
        raise BoardError(Fault("board-missing", self._board.name, message)) from why

    def _refused(self, what: str, error: SdoAbortedError) -> BoardError:
        text = SdoAbortedError.CODES.get(error.code, "reason unknown").lower()
        message = f"board {self._board.name} refuses {what}: {text} (abort {error.code:08X}h)"
        return BoardError(Fault("sdo-refused", self._board.name, message))


def _absent(entry: Entry, error: SdoAbortedError) -> bool:
    return entry.optional and error.code in (_NO_OBJECT, _NO_SUB_INDEX)
