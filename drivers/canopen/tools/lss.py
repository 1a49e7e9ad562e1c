"""Node ids and bit rates by LSS, the layer setting services (CiA 305), with the LSS master of the package canopen."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

from canopen.lss import (
    CS_FAST_SCAN,
    CS_IDENTIFY_SLAVE,
    CS_INQUIRE_PRODUCT_CODE,
    CS_INQUIRE_REVISION_NUMBER,
    CS_INQUIRE_SERIAL_NUMBER,
    CS_INQUIRE_VENDOR_ID,
    CS_SWITCH_STATE_SELECTIVE_RESPONSE,
    CS_SWITCH_STATE_SELECTIVE_SERIAL_NUMBER,
    ListMessageNeedResponse,
    LssError,
    LssMaster,
)

from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.events import FrameEchoed, FrameReceived

_REQUEST, _ANSWER = LssMaster.LSS_TX_COBID, LssMaster.LSS_RX_COBID
_LSS_TIMEOUT, _TRIES = 1.0, 3  # [s] for an answer, and attempts
_SCAN_TIMEOUT = 0.2  # [s] for an answer in a fast scan, where silence is an answer
_PAUSE = 0.02  # [s] after a request without an answer: some boards keep only one request
_MORE = 0.05  # [s] for the answers of other boards after the first one
_POLL = 0.001  # [s]
_MOST_BOARDS = 127
BIT_TIMINGS = {  # index by bit rate [bit/s]
    1_000_000: 0,
    800_000: 1,
    500_000: 2,
    250_000: 3,
    125_000: 4,
    50_000: 6,
    20_000: 7,
    10_000: 8,
}

_PARTS = (
    CS_INQUIRE_VENDOR_ID,
    CS_INQUIRE_PRODUCT_CODE,
    CS_INQUIRE_REVISION_NUMBER,
    CS_INQUIRE_SERIAL_NUMBER,
)

_ANSWERS = {  # first byte of an answer by that of its request, where the two differ
    CS_SWITCH_STATE_SELECTIVE_SERIAL_NUMBER: CS_SWITCH_STATE_SELECTIVE_RESPONSE,
    CS_FAST_SCAN: CS_IDENTIFY_SLAVE,
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
        self._master = cast(Any, LssMaster())
        self._master.network = self  # the package's master uses only send_message of its network
        self._master.RESPONSE_TIMEOUT = 0.001  # the answers are there before it waits
        self._exchange, self._timeout, self._tries = exchange, _LSS_TIMEOUT, _TRIES
        self._silent = False  # whether the last request had no answer that was due
        self._identity: dict[int, bytes] = {}  # answers with the parts of the selected board's identity, by first byte

    def send_message(self, cob_id: int, data: bytes, remote: bool = False) -> None:
        """Sends a request of the package's master and passes the answer to it.

        Raises:
            LssRefused: several boards answer differently.
        """
        self._silent = due = data[0] in ListMessageNeedResponse
        code = _ANSWERS.get(data[0], data[0]) if due else None
        for _ in range(self._tries if due else 1):
            heard = {answer for answer in self._exchange(bytes(data), code, self._timeout) if answer}
            own = [answer for answer in heard if answer[0] == code]
            if len(own) > 1 or any(self._identity.get(late[0], late) != late for late in heard):
                raise LssRefused("several boards answer: connect one alone, or name one by its identity")
            if own:
                if data[0] in _PARTS:
                    self._identity[data[0]] = own[0]
                self._silent = False
                self._master.on_message_received(_ANSWER, own[0], 0.0)
                return

    def unconfigured(self) -> list[LssIdentity]:
        """Returns the boards without a node id, by LSS fast scan."""
        self.release()  # an earlier session may have ended in the configuration state
        self._timeout, self._tries = _SCAN_TIMEOUT, 1
        found: list[LssIdentity] = []
        try:
            while len(found) < _MOST_BOARDS:
                one, numbers = self._master.fast_scan()
                if not one:
                    break
                found.append(LssIdentity(*numbers))  # this board is silent in the next scan
        finally:
            self._timeout, self._tries = _LSS_TIMEOUT, _TRIES
            self.release()
        return found

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
        told = [self._ask("inquire identity", partial(self._master.inquire_lss_address, part)) for part in _PARTS]
        return LssIdentity(*told), self._ask("inquire node id", self._master.inquire_node_id)

    def _switch(self, identity: LssIdentity | None) -> None:
        """Switches one board to the configuration state, which it must prove by an answer."""
        if identity is None:
            self._master.send_switch_state_global(LssMaster.CONFIGURATION_STATE)
            self._ask("select", partial(self._master.inquire_lss_address, CS_INQUIRE_VENDOR_ID))
        else:
            self._ask(f"select {identity}", lambda: self._master.send_switch_state_selective(*identity))

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
                self._ask(f"node id {node}", lambda: self._master.configure_node_id(node))
            if bitrate is not None:
                timing = BIT_TIMINGS[bitrate]
                self._ask(f"{bitrate} bit/s", lambda: self._master.configure_bit_timing(timing))
            self._ask("store", self._master.store_configuration)
            stored = True
        finally:
            if not stored and node is not None:
                with contextlib.suppress(LssRefused):
                    self._ask(f"node id {old}", lambda: self._master.configure_node_id(old))

    def release(self) -> None:
        """Returns all boards to the LSS waiting state."""
        self._identity.clear()
        self._master.send_switch_state_global(LssMaster.WAITING_STATE)

    def _ask(self, what: str, request: Callable[[], object]) -> int:
        try:
            answer = request()
        except LssError as error:
            if self._silent:
                raise LssSilent(f"{what}: no board answers by LSS") from None
            raise LssRefused(f"{what}: the board refuses ({error})") from None
        return answer if isinstance(answer, int) else 0


def over(bus: CanBus) -> Exchange:
    """Returns an `Exchange` over an open bus."""

    def heard() -> list[bytes]:
        # The frames of a board that runs on this computer are echoes, as those of this process.
        frames = [event.frame for event in bus.poll() if isinstance(event, FrameEchoed | FrameReceived)]
        return [frame.data for frame in frames if frame.id == _ANSWER]

    def exchange(request: bytes, code: int | None, timeout: float) -> list[bytes]:
        answers = heard()
        answered = False
        if (why := bus.send_frame(Frame(_REQUEST, request))) is not None:
            raise LssRefused(f"{bus.name}: {why}")
        until = time.monotonic() + (_PAUSE if code is None else timeout)
        while time.monotonic() < until:
            answers += (got := heard())
            if not answered and any(answer[:1] == bytes((code,)) for answer in got if code is not None):
                answered, until = True, time.monotonic() + _MORE
            time.sleep(_POLL)
        return answers

    return exchange
