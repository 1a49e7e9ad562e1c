"""The LSS slave of a simulated board: an LSS master sets its node id and bit rate over the bus (CiA 305)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

REQUEST, ANSWER = 0x7E5, 0x7E4  # COB-IDs
UNCONFIGURED = 0xFF  # node id of a board without one
WAITING, CONFIGURATION = 0, 1

_SWITCH_GLOBAL, _SWITCHED = 0x04, 0x44
_SELECT = (0x40, 0x41, 0x42, 0x43)  # vendor, product, revision, serial
_NODE_ID, _BIT_TIMING, _STORE = 0x11, 0x13, 0x17
_INQUIRE = (0x5A, 0x5B, 0x5C, 0x5D)
_INQUIRE_NODE_ID = 0x5E
_IDENTIFIED, _FAST_SCAN = 0x4F, 0x51
_ALL_BITS = 0x80  # first request of a fast scan
_OUT_OF_RANGE = 1  # error code
_TIMINGS = range(9)  # indices of the table of bit rates


class LssSlave:
    """Node id, or `UNCONFIGURED`, and bit rate of a board, which an LSS master can change.

    `identity` is vendor, product, revision and serial number; `send` takes COB-ID and data of an answer.
    """

    def __init__(self, identity: Sequence[int], node: int, send: Callable[[int, bytes], None]) -> None:
        self.node = node  # in use; `UNCONFIGURED` if there is none
        self.stored = node, 0  # node id and index of the bit rate after the next power-on
        self.state = WAITING  # `WAITING` or `CONFIGURATION`
        self._identity, self._send = identity, send
        self.pending = self.stored
        self._selected = 0  # parts of the identity that have matched so far
        self._scanned = 0  # part of the identity that the fast scan has reached

    def reset(self) -> None:
        """Applies the stored values, as after power-on."""
        self.node, self.state, self._selected = self.stored[0], WAITING, 0
        self.pending = self.stored

    def receive(self, data: bytes) -> None:
        if len(data) != 8:
            return
        command, number = data[0], int.from_bytes(data[1:5], "little")
        if command == _SWITCH_GLOBAL:
            self.state = CONFIGURATION if data[1] else WAITING
        elif command in _SELECT:
            self._select(_SELECT.index(command), number)
        elif command == _FAST_SCAN:
            self.scan(number, *data[5:8])
        elif self.state == CONFIGURATION:
            self._configure(command, data)

    def _configure(self, command: int, data: bytes) -> None:
        if command == _NODE_ID:
            right = 1 <= data[1] <= 127 or data[1] == UNCONFIGURED
            if right:
                self.pending = data[1], self.pending[1]
            self.answer(bytes((command, 0 if right else _OUT_OF_RANGE)))
        elif command == _BIT_TIMING:
            right = data[1] == 0 and data[2] in _TIMINGS
            if right:
                self.pending = self.pending[0], data[2]
            self.answer(bytes((command, 0 if right else _OUT_OF_RANGE)))
        elif command == _STORE:
            self.stored = self.pending
            self.answer(bytes((command, 0)))
        elif command in _INQUIRE:
            self.answer(struct.pack("<BI", command, self._identity[_INQUIRE.index(command)]))
        elif command == _INQUIRE_NODE_ID:
            self.answer(bytes((command, self.node)))

    def _select(self, part: int, number: int) -> None:
        if self.state == CONFIGURATION:
            return
        self._selected = part + 1 if self._selected == part and number == self._identity[part] else 0
        if self._selected == len(_SELECT):
            self.state, self._selected = CONFIGURATION, 0
            self.answer(bytes((_SWITCHED,)))

    def scan(self, number: int, bit: int, part: int, following: int) -> None:
        """Answers if the bits from `bit` on match; a slave that did not match stays silent until the next scan."""
        if self.state == CONFIGURATION or self.node != UNCONFIGURED:
            return
        if bit == _ALL_BITS:
            self._scanned = 0
            self.answer(bytes((_IDENTIFIED,)))
        elif part == self._scanned < len(_SELECT) and bit < 32 and number >> bit == self._identity[part] >> bit:
            if bit == 0 and following != part:
                self._scanned = following
                if following < part:
                    self.state = CONFIGURATION
            self.answer(bytes((_IDENTIFIED,)))

    def answer(self, data: bytes) -> None:
        self._send(ANSWER, data.ljust(8, b"\0"))
