"""Node ids and bit rates by LSS, the layer setting services (CiA 305)."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Collection
from itertools import islice
from typing import NamedTuple

from hyperbit.drivers.canopen.tools.session import Session
from hyperbit.drivers.canopen.wire.cia301 import Frame

_REQUEST, _ANSWER = 0x7E5, 0x7E4  # COB-IDs
_SWITCH, _SELECT, _SELECTED, _SCAN, _SCANNED = 0x04, (0x40, 0x41, 0x42, 0x43), 0x44, 0x51, 0x4F
_NODE_ID, _BIT_TIMING, _STORE, _INQUIRE, _INQUIRE_NODE_ID = 0x11, 0x13, 0x17, (0x5A, 0x5B, 0x5C, 0x5D), 0x5E
_WAITING, _CONFIGURATION = 0, 1
_ANY, _WITHOUT_ID = 0x80, 0xFF  # bit check of a scan that each board answers, and node id of a board without one
_TIMEOUT, _TRIES = 1.0, 3  # [s] for an answer, and attempts
_SCAN_TIMEOUT = 0.2  # [s] for an answer in a fast scan, where silence is an answer
_PAUSE = 0.02  # [s] after a request without an answer: some boards keep only one request
_MORE = 0.05  # [s] for the answers of other boards after the first one
_MOST_BOARDS = 127
_RATES = (1_000_000, 800_000, 500_000, 250_000, 125_000, 0, 50_000, 20_000, 10_000)
BIT_TIMINGS = {rate: index for index, rate in enumerate(_RATES) if rate}  # index by bit rate [bit/s]
_REFUSALS = {
    (_NODE_ID, 1): "it is out of range",
    (_BIT_TIMING, 1): "the board has no such bit rate",
    (_STORE, 1): "it cannot store",
    (_STORE, 2): "its memory cannot be written",
}

# Request, first byte of its answer (None: none is expected), time for the answer [s] -> answers since the last request.
Exchange = Callable[[bytes, int | None, float], list[bytes]]


class LssRefused(Exception):
    """A board does not answer, or refuses; the text says which request."""


class LssSilent(LssRefused):
    """No board answers."""


class LssIdentity(NamedTuple):
    """The identity of a board, 1018h."""

    vendor: int
    product: int
    revision: int
    serial: int

    def __str__(self) -> str:
        return ":".join(f"{number:#x}" for number in self)


class Lss:
    """Talks to LSS slaves.

    Args:
        exchange: sends a request and returns the answers of all boards.
    """

    def __init__(self, exchange: Exchange) -> None:
        self._exchange, self._tries = exchange, _TRIES
        self._identity: dict[int, bytes] = {}  # answers with the parts of the selected board's identity, by first byte

    def unconfigured(self) -> list[LssIdentity]:
        """Returns the boards without a node id, by LSS fast scan.

        A selected board is silent in a scan. So each board that was found is selected before the next scan. Some
        boards answer all the same (CANopenNode), or have a node id and answer (Lely). So each one is asked alone.
        """
        found: dict[LssIdentity, int] = {}
        try:
            while len(found) < _MOST_BOARDS and (one := self._scan(found)) is not None:
                self.release()
                try:
                    self._switch(one)
                    found[one] = self._ask("inquire node id", _INQUIRE_NODE_ID)[1]
                except LssSilent:  # nobody has this identity: a selected board has answered
                    break
        finally:
            self.release()
        return [one for one, node in found.items() if node == _WITHOUT_ID]

    def select(self, identity: LssIdentity | None) -> tuple[LssIdentity, int]:
        """Selects one board for configuration; returns its identity and node id.

        Args:
            identity: identity of the board; None: the only board on the bus.

        Raises:
            LssRefused: no such board answers, or several do.
        """
        self._tries = 1  # of a single request: after a lost frame the board must be selected again
        for attempt in range(_TRIES):
            self.release()  # an earlier session may have ended in the configuration state
            try:
                self._switch(identity)
                break
            except LssSilent:
                if attempt == _TRIES - 1:
                    raise
            finally:
                self._tries = _TRIES
        parts = [self._ask("inquire identity", part) for part in _INQUIRE]
        told = (int.from_bytes(part[1:5], "little") for part in parts)
        return LssIdentity(*told), self._ask("inquire node id", _INQUIRE_NODE_ID)[1]

    def configure(self, old: int, node: int | None, bitrate: int | None) -> None:
        """Sets and stores node id and bit rate [bit/s] of the selected board; None: unchanged.

        A node id that was set and not stored would still apply after an NMT reset of the communication. If the board
        does not confirm that it has stored, it gets its old node id back.

        Args:
            old: node id of the board.
            node: new node id.
            bitrate: new bit rate [bit/s].

        Raises:
            LssRefused: the board refuses, or does not confirm that it has stored.
        """
        stored = False
        try:
            if node is not None:
                self._set(f"node id {node}", _NODE_ID, node)
            if bitrate is not None:
                self._set(f"{bitrate} bit/s", _BIT_TIMING, 0, BIT_TIMINGS[bitrate])
            self._set("store", _STORE)
            stored = True
        finally:
            if not stored and node is not None:
                with contextlib.suppress(LssRefused):
                    self._set(f"node id {old}", _NODE_ID, old)

    def release(self) -> None:
        """Returns all boards to the LSS waiting state."""
        self._identity.clear()
        self._send(_SWITCH, _WAITING)

    def _switch(self, identity: LssIdentity | None) -> None:
        """Switches one board to the configuration state, which it must prove by an answer."""
        if identity is None:
            self._send(_SWITCH, _CONFIGURATION)
            self._ask("select", _INQUIRE[0])
            return
        for part, number in islice(zip(_SELECT, identity, strict=True), 3):
            self._send(part, *number.to_bytes(4, "little"))
        self._ask(f"select {identity}", _SELECT[3], *identity.serial.to_bytes(4, "little"), code=_SELECTED)

    def _scan(self, selected: Collection[LssIdentity]) -> LssIdentity | None:
        """Returns the identity of a board that answers a fast scan, bit by bit; None if none does."""
        self.release()
        for one in selected:
            with contextlib.suppress(LssSilent):
                self._switch(one)
        if not self._scanned(0, _ANY, 0, 0):
            return None
        numbers: list[int] = []
        for part in range(4):
            number = 0
            for bit in reversed(range(32)):
                if not self._scanned(number, bit, part, part):
                    number |= 1 << bit
            if not self._scanned(number, 0, part, (part + 1) % 4):
                return None
            numbers.append(number)
        return LssIdentity(*numbers)

    def _scanned(self, number: int, bit: int, part: int, following: int) -> bool:
        """Returns whether a board answers that this part of its identity is `number` from `bit` upwards."""
        request = struct.pack("<BIBBB", _SCAN, number, bit, part, following)
        return any(answer[:1] == bytes([_SCANNED]) for answer in self._exchange(request, _SCANNED, _SCAN_TIMEOUT))

    def _set(self, what: str, *request: int) -> None:
        """Sends a request that the selected board confirms or refuses."""
        error = self._ask(what, *request)[1]
        if error:
            why = _REFUSALS.get((request[0], error), f"error {error}")
            raise LssRefused(f"{what}: the board refuses: {why}")

    def _send(self, *request: int) -> None:
        """Sends a request that has no answer."""
        self._exchange(bytes(request).ljust(8, b"\0"), None, 0.0)

    def _ask(self, what: str, *request: int, code: int | None = None) -> bytes:
        """Returns the answer of the selected board, whose first byte is `code`, or that of the request."""
        code = request[0] if code is None else code
        for _ in range(self._tries):
            heard = {answer for answer in self._exchange(bytes(request).ljust(8, b"\0"), code, _TIMEOUT) if answer}
            own = [answer for answer in heard if answer[0] == code and len(answer) == 8]
            if len(own) > 1 or any(self._identity.get(late[0], late) != late for late in heard):
                raise LssRefused("several boards answer: connect one alone, or name one by its identity")
            if own:
                if code in _INQUIRE:
                    self._identity[code] = own[0]
                return own[0]
        raise LssSilent(f"{what}: no board answers by LSS")


def over(session: Session, bus: str) -> Exchange:
    """Returns an `Exchange` over a bus of a session; it raises what the session raises."""

    def exchange(request: bytes, code: int | None, timeout: float) -> list[bytes]:
        before = len(session.heard)
        session.send_frame(bus, Frame(_REQUEST, request))

        def answered() -> bool:
            return any(frame.id == _ANSWER and frame.data[0] == code for frame in session.heard[before:] if frame.data)

        if session.wait(answered, _PAUSE if code is None else timeout):
            session.wait(lambda: False, _MORE)
        answers = [frame.data for frame in session.heard if frame.id == _ANSWER]
        session.heard.clear()
        return answers

    return exchange
