"""Node ids and bit rates by LSS, the layer setting services (CiA 305)."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Collection
from itertools import islice
from typing import NamedTuple

from hyperbit.drivers.canopen.tools.session import Session
from hyperbit.drivers.canopen.wire.cia301 import Frame

_REQUEST, _ANSWER = 0x7E5, 0x7E4  # COB-IDs
_SWITCH, _SELECT, _SELECTED, _SCAN, _SCANNED = 0x04, (0x40, 0x41, 0x42, 0x43), 0x44, 0x51, 0x4F
_NODE_ID, _BIT_TIMING, _STORE, _INQUIRE, _INQUIRE_NODE_ID = 0x11, 0x13, 0x17, (0x5A, 0x5B, 0x5C, 0x5D), 0x5E
_WAITING, _CONFIGURATION = 0, 1
_ANY, _WITHOUT_ID = 0x80, 0xFF  # bit check that each board answers in a scan; node id of an unconfigured board
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
    """Sends LSS requests to the slaves of a bus. Raises LssRefused, and the exceptions of the session."""

    def __init__(self, session: Session, bus: str) -> None:
        self._session, self._bus = session, bus
        self._identity: dict[int, bytes] = {}  # answers with the parts of the selected board's identity, by first byte

    def unconfigured(self) -> list[LssIdentity]:
        """Returns the boards without a node id, by LSS fast scan.

        A selected board is silent in a scan. So each board found is selected before the next scan. Some boards answer
        all the same (CANopenNode), or answer although they have a node id (Lely). So each one is asked alone.
        """
        found: dict[LssIdentity, int] = {}
        try:
            while len(found) < _MOST_BOARDS and (one := self._scan(found)) is not None:
                self.release()
                try:
                    self._switch(one)
                    found[one] = self._ask("inquire node id", _INQUIRE_NODE_ID)[1]
                except LssSilent:  # no unselected board has this identity: a selected board has answered
                    break
        finally:
            self.release()
        return [one for one, node in found.items() if node == _WITHOUT_ID]

    def select(self, identity: LssIdentity | None) -> tuple[LssIdentity, int]:
        """Selects one board, or the only one on the bus (None), for configuration; returns its identity and node id."""
        for attempt in range(_TRIES):
            self.release()  # an earlier session may have ended in the configuration state
            try:
                self._switch(identity, tries=_TRIES if attempt else 1)  # after a lost frame it must be selected again
                break
            except LssSilent:
                if attempt == _TRIES - 1:
                    raise
        told = [int.from_bytes(self._ask("inquire identity", part)[1:5], "little") for part in _INQUIRE]
        return LssIdentity(*told), self._ask("inquire node id", _INQUIRE_NODE_ID)[1]

    def configure(self, old: int, node: int | None, bitrate: int | None) -> None:
        """Sets and stores node id and bit rate [bit/s] of the selected board; None: unchanged.

        A node id that was set but not stored would apply after an NMT reset of the communication. If the board does not
        confirm the storage, it gets its `old` node id back.
        """
        try:
            if node is not None:
                self._set(f"node id {node}", _NODE_ID, node)
            if bitrate is not None:
                self._set(f"{bitrate} bit/s", _BIT_TIMING, 0, BIT_TIMINGS[bitrate])
            self._set("store", _STORE)
        except BaseException:
            if node is not None:
                with contextlib.suppress(LssRefused):
                    self._set(f"node id {old}", _NODE_ID, old)
            raise

    def release(self) -> None:
        """Returns all boards to the LSS waiting state."""
        self._identity.clear()
        self._exchange(bytes((_SWITCH, _WAITING)))

    def _switch(self, identity: LssIdentity | None, tries: int = _TRIES) -> None:
        """Switches one board to the configuration state. Its answer must prove that."""
        if identity is None:
            self._exchange(bytes((_SWITCH, _CONFIGURATION)))
            self._ask("select", _INQUIRE[0], tries=tries)
            return
        for part, number in islice(zip(_SELECT, identity, strict=True), 3):
            self._exchange(struct.pack("<BI", part, number))
        serial = identity.serial.to_bytes(4, "little")
        self._ask(f"select {identity}", _SELECT[3], *serial, code=_SELECTED, tries=tries)

    def _scan(self, selected: Collection[LssIdentity]) -> LssIdentity | None:
        """Returns the identity of a board that answers a fast scan, bit by bit; the `selected` ones are silent."""
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
        if error := self._ask(what, *request)[1]:
            why = _REFUSALS.get((request[0], error), f"error {error}")
            raise LssRefused(f"{what}: the board refuses: {why}")

    def _ask(self, what: str, *request: int, code: int | None = None, tries: int = _TRIES) -> bytes:
        """Returns the selected board's answer, whose first byte is `code`, or that of the request."""
        code = request[0] if code is None else code
        for _ in range(tries):
            heard = {answer for answer in self._exchange(bytes(request), code, _TIMEOUT) if answer}
            own = [answer for answer in heard if answer[0] == code and len(answer) == 8]
            if len(own) > 1 or any(self._identity.get(late[0], late) != late for late in heard):
                raise LssRefused("several boards answer: connect one alone, or name one by its identity")
            if own:
                if code in _INQUIRE:
                    self._identity[code] = own[0]
                return own[0]
        raise LssSilent(f"{what}: no board answers by LSS")

    def _exchange(self, request: bytes, code: int | None = None, timeout: float = _PAUSE) -> list[bytes]:
        """Sends a request; returns all answers since the last one. Waits for one whose first byte is `code`."""
        session, before = self._session, len(self._session.heard)
        session.send_frame(self._bus, Frame(_REQUEST, request.ljust(8, b"\0")))

        def answered() -> bool:
            return any(frame.id == _ANSWER and frame.data[0] == code for frame in session.heard[before:] if frame.data)

        if session.wait(answered, timeout):
            session.wait(lambda: False, _MORE)
        answers = [frame.data for frame in session.heard if frame.id == _ANSWER]
        session.heard.clear()
        return answers
