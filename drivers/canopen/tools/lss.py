"""Node ids and bit rates by LSS, the layer setting services (CiA 305), with the LSS master of the package canopen."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

from canopen.lss import (
    CS_INQUIRE_PRODUCT_CODE,
    CS_INQUIRE_REVISION_NUMBER,
    CS_INQUIRE_SERIAL_NUMBER,
    CS_INQUIRE_VENDOR_ID,
    ListMessageNeedResponse,
    LssError,
    LssMaster,
)

from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.events import Received

_REQUEST, _ANSWER = LssMaster.LSS_TX_COBID, LssMaster.LSS_RX_COBID
_PATIENCE, _SCAN_PATIENCE = 2.0, 0.2  # [s] for an answer; and in a fast scan, where silence is an answer
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

Exchange = Callable[[bytes, float], list[bytes]]  # request, time for an answer [s] (0: none is expected) -> answers


class Refused(Exception):
    """A board does not answer, or refuses; the text says which request."""


class Identity(NamedTuple):
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
        self._exchange, self._patience = exchange, _PATIENCE

    def send_message(self, cob_id: int, data: bytes, remote: bool = False) -> None:
        """Sends a request of the package's master and passes the answer to it.

        Raises:
            Refused: several boards answer differently.
        """
        due = data[0] in ListMessageNeedResponse
        answers = self._exchange(bytes(data), self._patience if due else 0.0)
        if len(set(answers)) > 1:
            raise Refused("several boards answer: connect one alone, or name one by its identity")
        for answer in answers[:1]:
            self._master.on_message_received(_ANSWER, answer, 0.0)

    def unconfigured(self) -> list[Identity]:
        """Returns the boards without a node id, by LSS fast scan."""
        self._patience = _SCAN_PATIENCE
        found: list[Identity] = []
        try:
            while len(found) < _MOST_BOARDS:
                one, numbers = self._master.fast_scan()
                if not one:
                    break
                found.append(Identity(*numbers))  # this board is silent in the next scan
        finally:
            self._patience = _PATIENCE
            self.release()
        return found

    def select(self, identity: Identity | None) -> tuple[Identity, int]:
        """Selects one board for configuration; returns its identity and node id.

        Args:
            identity: identity of the board; None: the only board on the bus.

        Raises:
            Refused: no such board answers, or several do.
        """
        if identity is None:
            self._ask("select", lambda: self._master.send_switch_state_global(LssMaster.CONFIGURATION_STATE))
        else:
            self._ask(f"select {identity}", lambda: self._master.send_switch_state_selective(*identity))
        told = [self._ask("inquire identity", partial(self._master.inquire_lss_address, part)) for part in _PARTS]
        return Identity(*told), self._ask("inquire node id", self._master.inquire_node_id)

    def configure(self, node: int | None, bitrate: int | None) -> None:
        """Sets and stores node id and bit rate [bit/s] of the selected board; None: unchanged.

        Raises:
            Refused: the board refuses.
        """
        if node is not None:
            self._ask(f"node id {node}", lambda: self._master.configure_node_id(node))
        if bitrate is not None:
            timing = BIT_TIMINGS[bitrate]
            self._ask(f"{bitrate} bit/s", lambda: self._master.configure_bit_timing(timing))
        self._ask("store", self._master.store_configuration)

    def release(self) -> None:
        """Returns all boards to the LSS waiting state."""
        self._master.send_switch_state_global(LssMaster.WAITING_STATE)

    def _ask(self, what: str, request: Callable[[], object]) -> int:
        try:
            answer = request()
        except LssError as error:
            why = "no board answers by LSS" if "No LSS response" in str(error) else f"the board refuses ({error})"
            raise Refused(f"{what}: {why}") from None
        return answer if isinstance(answer, int) else 0


def over(bus: CanBus) -> Exchange:
    """Returns an `Exchange` over an open bus."""

    def exchange(request: bytes, patience: float) -> list[bytes]:
        bus.poll()
        if (why := bus.send(Frame(_REQUEST, request))) is not None:
            raise Refused(f"{bus.name}: {why}")
        answers: list[bytes] = []
        until = time.monotonic() + patience
        while time.monotonic() < until:
            got = [e.frame.data for e in bus.poll() if isinstance(e, Received) and e.frame.id == _ANSWER]
            if got and not answers:
                until = time.monotonic() + _MORE
            answers += got
            time.sleep(_POLL)
        return answers

    return exchange
