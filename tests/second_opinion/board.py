"""Boards of another stack: python-canopen's SDO server, with CiA 301 and CiA 401 written from the standards on top.

They share no code with `drivers`; tests/README.md tells what they lack. Time and frames come from the caller.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from tests.second_opinion.dictionary import CONSUMERS, INVALID, PDOS, Dictionary, Kind

START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82  # NMT commands
BOOTING, STOPPED, OPERATIONAL, READY = 0, 4, 5, 127  # NMT states; READY is pre-operational
LOST, TOO_SHORT = 0x8130, 0x8210  # emergencies: heartbeat, length of a PDO
COMMUNICATION_ERROR = 0x11  # 1001h: generic, communication
TRAVEL = 0.02  # [s] of an actuator; its end-stop is the input of the same number


class Change(NamedTuple):
    """A change of a board's pins: bit k is output k.

    Attributes:
        cause: "SYNC", "RPDO", "START", "error", "SDO write", "NMT" or "power".
    """

    node: int
    cause: str
    before: int
    after: int

    @property
    def energised(self) -> int:
        return self.after & ~self.before


class Board:
    """A board of 16 outputs and 16 inputs.

    Attributes:
        state: NMT state; None without supply.

    Args:
        send: takes COB-ID and data of each frame that it sends.
    """

    def __init__(
        self, node: int, kind: Kind, send: Callable[[int, bytes], None], changed: Callable[[Change], None]
    ) -> None:
        self.node, self.kind, self._send, self._changed = node, kind, send, changed
        self.pins, self.state, self._now = 0, None, 0.0
        self._inputs = 0
        self._moves: deque[tuple[float, int]] = deque()
        self.power_on(0.0)

    def power_on(self, now: float) -> None:
        self._now = now
        self._restart(everything=True)

    def power_off(self, now: float) -> None:
        self._now = now
        self._drive(0, "power")
        self.state = None

    def _restart(self, everything: bool) -> None:
        if everything:
            self.entries = Dictionary(self.node, self.kind, self._send, self._stored)
            self.register = 0
            self._drive(0, "power")
        else:
            self.entries.reset(0x1000, 0x1FFF)
        self._heard: dict[int, float | None] = {}  # node of a consumer entry -> last heartbeat
        self._lost: set[int] = set()
        self._waiting: dict[int, bytes] = {}  # RPDO -> data until SYNC
        self._sent: dict[int, bytes] = {}  # TPDO -> data last sent
        self._next_beat = self._now
        self.state = BOOTING
        self._send(0x700 + self.node, bytes([BOOTING]))
        self._enter(READY)

    def _command(self, command: int) -> None:
        match command:
            case 1 if self.state != OPERATIONAL:
                self._enter(OPERATIONAL)
                self._apply("START")
                self._send_inputs(always=True)
            case 2 if self.state != STOPPED:
                self._enter(STOPPED)
                self._error_mode("NMT")
            case 0x80 if self.state != READY:
                self._enter(READY)
            case 0x81 | 0x82:
                self._restart(everything=command == RESET_NODE)

    def _enter(self, state: int) -> None:
        self.state = state
        self._waiting.clear()
        self._sent.clear()
        if self.kind.off_outside_operational and state != OPERATIONAL:
            self._drive(0, "NMT")

    def step(self, now: float) -> None:
        """Sends what is due, and looks for lost heartbeats."""
        self._now = now
        while self._moves and self._moves[0][0] <= now:
            self._inputs = self._moves.popleft()[1]
        if self.state is None:
            return
        period = self.entries.number(0x1017) / 1000
        if period and now >= self._next_beat:
            self._next_beat = now + period
            self._send(0x700 + self.node, bytes([self.state]))
        for node, timeout in self._consumers().items():
            heard = self._heard.get(node)
            if heard is not None and node not in self._lost and now - heard > timeout:
                self._lose(node)
        for sub in (1, 2):
            self.entries.put(0x6000, sub, self._inputs >> 8 * (sub - 1) & 0xFF)
        self._send_inputs()

    def _consumers(self) -> dict[int, float]:
        """Returns the longest silence [s] of each supervised node, 1016h."""
        values = [self.entries.number(CONSUMERS, sub) for sub in (1, 2)]
        return {value >> 16 & 0x7F: (value & 0xFFFF) / 1000 for value in values if value & 0xFFFF and value >> 16}

    def _lose(self, node: int) -> None:
        """Reports a lost heartbeat, applies the error mode and the error behaviour."""
        self._lost.add(node)
        self.register |= COMMUNICATION_ERROR
        self._report(LOST, node)
        behaviour = self.entries.number(0x1029, 1) if self.entries.has(0x1029) else 0
        if self.state == OPERATIONAL and behaviour in (0, 2):
            self._enter(STOPPED if behaviour == 2 else READY)
        self._error_mode("error")

    def _report(self, code: int, more: int = 0) -> None:
        self.entries.put(0x1001, 0, self.register)
        if code or self.kind.end_in_history:
            self.entries.note_error(code or 0x1B000000)
        cob_id = self.entries.number(0x1014)
        if self.state != STOPPED and not cob_id & INVALID:
            self._send(cob_id & 0x7FF, struct.pack("<HB5s", code, self.register, bytes([more])))

    def receive(self, cob_id: int, data: bytes, now: float) -> None:
        self._now = now
        if self.state is None:
            return
        if cob_id == 0:
            if len(data) == 2 and data[1] in (0, self.node):
                self._command(data[0])
        elif cob_id == 0x600 + self.node:
            if self.state != STOPPED and len(data) == 8:
                self.entries.sdo.on_request(cob_id, data, now)
        elif 0x700 < cob_id < 0x780:
            self._hear(cob_id - 0x700)
        elif self.state == OPERATIONAL:
            if cob_id == self.entries.number(0x1005) & 0x7FF:
                self._sync()
            self._take_rpdo(cob_id, data)

    def _hear(self, node: int) -> None:
        if node not in self._consumers():
            return
        self._heard[node] = self._now
        if node in self._lost:
            self._lost.discard(node)
            if not self._lost:
                self.register &= ~COMMUNICATION_ERROR
                self._report(0)

    def _take_rpdo(self, cob_id: int, data: bytes) -> None:
        for k in range(PDOS):
            if self.entries.number(0x1400 + k, 1) != cob_id:
                continue
            if len(data) < len(self.entries.mapping(0x1600 + k)):
                self._report(TOO_SHORT)
            elif self.entries.number(0x1400 + k, 2) <= 240:
                self._waiting[k] = data
            else:
                self._store(k, data)
                self._apply("RPDO")

    def _sync(self) -> None:
        waiting, self._waiting = self._waiting, {}
        for k, data in waiting.items():
            self._store(k, data)
        if waiting:
            self._apply("SYNC")

    def _store(self, k: int, data: bytes) -> None:
        for (index, sub), byte in zip(self.entries.mapping(0x1600 + k), data, strict=False):
            if index == 0x6200:
                self.entries.put(index, sub, byte)

    def _send_inputs(self, always: bool = False) -> None:
        if self.state != OPERATIONAL:
            return
        enabled = not self.entries.has(0x6005) or self.entries.number(0x6005)
        for k in range(PDOS):
            cob_id, kind = self.entries.number(0x1800 + k, 1), self.entries.number(0x1800 + k, 2)
            if cob_id & INVALID or kind < 254:
                continue
            data = bytes(self.entries.number(*place) for place in self.entries.mapping(0x1A00 + k))
            before = self._sent.setdefault(k, data)
            if always or (enabled and before != data):
                self._sent[k] = data
                self._send(cob_id & 0x7FF, data)

    def _stored(self, index: int, sub: int) -> None:
        if index == 0x6200 and self.state == OPERATIONAL:
            self._apply("SDO write")
        elif index == CONSUMERS:  # supervision begins with the next heartbeat
            self._heard.clear()
            self._lost.clear()
        elif index == 0x1017:
            self._next_beat = self._now

    def _apply(self, cause: str) -> None:
        """Drives the pins as 6200h says."""
        self._drive(self.entries.word(0x6200), cause)

    def _error_mode(self, cause: str) -> None:
        """Drives the pins as 6206h and 6207h say; without them they stay. 6200h keeps its value."""
        if self.entries.has(0x6206):
            mode = self.entries.word(0x6206)
            self._drive(self.pins & ~mode | self.entries.word(0x6207) & mode, cause)

    def _drive(self, pins: int, cause: str) -> None:
        if pins != self.pins:
            before, self.pins = self.pins, pins
            self._moves.append((self._now + TRAVEL, pins))
            self._changed(Change(self.node, cause, before, pins))
