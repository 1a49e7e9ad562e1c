"""The object dictionary of a board: python-canopen's LocalNode with the rules of CiA 301 that it does not check."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from canopen import LocalNode, SdoAbortedError

FOLDER = Path(__file__).parent
INVALID = 1 << 31  # bit of a COB-ID
NO_DATA, LOCAL_STATE, RANGE, NOT_MAPPABLE, TOO_LONG = 0x08000024, 0x08000022, 0x06090030, 0x06040041, 0x06040042
HISTORY, CONSUMERS = 0x1003, 0x1016
MOST_ERRORS = 8


class NoNetwork:
    """What LocalNode needs of a network: it sends. Nothing runs in threads."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        self._send = send

    def send_message(self, cob_id: int, data: Any, remote: bool = False) -> None:
        self._send(cob_id, bytes(data))


class Dictionary(LocalNode):
    """Object dictionary, SDO server and emergency producer of one board.

    Attributes:
        history: entries of 1003h, the newest first.

    Args:
        stored: called with index and sub-index after each write over the bus.
        empty_is_no_data: an unused entry of 1003h is read with the abort code 08000024h, not as 0.
    """

    def __init__(self, node: int, eds: str, stored: Callable[[int, int], None], empty_is_no_data: bool) -> None:
        super().__init__(node, str(FOLDER / eds))
        self._write_callbacks.remove(self.nmt.on_write)  # it would start a thread for 1017h
        self.history: list[int] = []
        self._stored, self._empty_is_no_data = stored, empty_is_no_data

    def connect(self, send: Callable[[int, bytes], None]) -> None:
        self.sdo.network = self.emcy.network = NoNetwork(send)

    def number(self, index: int, sub: int = 0) -> int:
        return int.from_bytes(self.get_data(index, sub), "little")

    def put(self, index: int, sub: int, value: int) -> None:
        size = len(self.get_data(index, sub))
        self.data_store.setdefault(index, {})[sub] = value.to_bytes(size, "little")

    def has(self, index: int) -> bool:
        return index in self.object_dictionary

    def note_error(self, entry: int) -> None:
        self.history = [entry, *self.history][:MOST_ERRORS]

    def reset(self, first: int, last: int) -> None:
        for index in [index for index in self.data_store if first <= index <= last]:
            del self.data_store[index]

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        if index == HISTORY and subindex <= MOST_ERRORS:
            if subindex == 0:
                return bytes([len(self.history)])
            if subindex <= len(self.history):
                return self.history[subindex - 1].to_bytes(4, "little")
            if self._empty_is_no_data:
                raise SdoAbortedError(NO_DATA)
            return bytes(4)
        return super().get_data(index, subindex, check_readable)

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        if check_writable:
            self._check(index, subindex, int.from_bytes(data, "little"))
        super().set_data(index, subindex, data, check_writable)
        if index == HISTORY:
            self.history = []
        if check_writable:
            self._stored(index, subindex)

    def _check(self, index: int, sub: int, value: int) -> None:
        """Refuses what CiA 301 forbids (7.5.2.17 for 1003h, 7.5.2.35 to 7.5.2.38 for PDOs)."""
        if index == HISTORY and value:
            raise SdoAbortedError(RANGE)
        if index & 0xFF00 in (0x1400, 0x1800) and sub == 1:
            before = self.number(index, 1)
            if not before & INVALID and not value & INVALID and before != value:
                raise SdoAbortedError(RANGE)
        if index & 0xFF00 in (0x1600, 0x1A00):
            self._check_mapping(index, sub, value)

    def _check_mapping(self, index: int, sub: int, value: int) -> None:
        if not self.number(index - 0x200, 1) & INVALID:
            raise SdoAbortedError(LOCAL_STATE)
        if sub:
            if self.number(index, 0):
                raise SdoAbortedError(LOCAL_STATE)
            self._check_entry(value, output=index < 0x1800)
        elif value > 8:
            raise SdoAbortedError(RANGE)
        elif sum(self.number(index, k) & 0xFF for k in range(1, value + 1)) > 64:
            raise SdoAbortedError(TOO_LONG)

    def _check_entry(self, entry: int, output: bool) -> None:
        index, sub, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        if index <= 7:
            known = output and index in (5,) and bits == 8  # DummyUsage of the EDS
        else:
            known = index == (0x6200 if output else 0x6000) and sub in (1, 2) and bits == 8
        if not known:
            raise SdoAbortedError(NOT_MAPPABLE)


def mapping(entries: Dictionary, index: int) -> list[tuple[int, int]]:
    """Returns index and sub-index of the mapped objects of a PDO, one byte each."""
    values = [entries.number(index, k) for k in range(1, entries.number(index, 0) + 1)]
    return [(value >> 16, value >> 8 & 0xFF) for value in values]
