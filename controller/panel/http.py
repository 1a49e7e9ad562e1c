"""HTTP and WebSocket connections: client certificates, and a time limit of requests."""

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

REQUEST_WITHIN = 10.0  # [s] to the end of a request, from the connection or the first byte of a further request


def common_name(transport: Any) -> str | None:
    """Returns the common name of a connection's client certificate; None if there is none."""
    connection = transport.get_extra_info("ssl_object")
    certificate = (connection.getpeercert() if connection is not None else None) or {}
    names = [value for part in certificate.get("subject", ()) for key, value in part if key == "commonName"]
    return str(names[0]) if len(names) == 1 else None


class GuardedHttp(H11Protocol):
    """HTTP with the common name of the client certificate. Closes a connection whose request stays incomplete too long.

    uvicorn has no such limit: its keep-alive time-out begins after the first answer.
    """

    def __init__(self, *words: Any, **named: Any) -> None:
        super().__init__(*words, **named)
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.app_state = {**self.app_state, "certificate": common_name(transport)}
        self._watch_request()

    def data_received(self, data: bytes) -> None:
        """Accepts data; the time of a request ends with its last byte."""
        super().data_received(data)
        self._watch_request()

    def connection_lost(self, exc: Exception | None) -> None:
        self._end_deadline()
        super().connection_lost(exc)

    def _watch_request(self) -> None:
        """Starts the time limit of an incomplete request; ends that of a complete one."""
        upgraded = self.transport.get_protocol() is not self
        if upgraded or self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._end_deadline()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(REQUEST_WITHIN, self.transport.abort)

    def _end_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class CertifiedWebSocket(WebSocketsSansIOProtocol):
    """A WebSocket whose connections carry the common name of the client certificate."""

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.app_state = {**self.app_state, "certificate": common_name(transport)}
