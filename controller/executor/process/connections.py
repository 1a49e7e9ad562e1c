"""Connections to the executor's socket: what waits to be sent, and which of too many give way."""

import logging
import socket
import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from typing import Literal

from hyperbit.controller.executor.core.events import ClientId

HELLO_TIMEOUT = 1.0  # [s] from the connection to its Hello
PLACES = {"silent": 16, "operator": 15}  # the core refuses a second planner, and its connection ends at once
LINES_EVERY = 1.0  # [s] between two lines of the log
CREDENTIALS = struct.Struct("3i")  # SO_PEERCRED: pid, uid, gid


class ClientConnection:
    """The connection of one client, with the messages that wait to be sent.

    Attributes:
        client: number and process.
        role: as its Hello says; None before the Hello.
        closing: whether a Goodbye was sent.
        since: time of the connection [s].
    """

    def __init__(self, number: int, connected: socket.socket, now: float) -> None:
        """Takes the number of the connection, its socket and the time [s]."""
        connected.setblocking(False)
        options = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
        self.client = ClientId(number, CREDENTIALS.unpack(options)[0])
        self.socket, self.since = connected, now
        self.waiting: deque[bytes] = deque()
        self.role: Literal["planner", "operator"] | None = None
        self.closing = False

    @property
    def place(self) -> str:
        """Which kind of place the connection takes: "silent", "operator" or "planner"."""
        return "silent" if self.role is None or self.closing else self.role

    def flush(self) -> bool:
        """Sends waiting messages until the client's buffer is full; returns whether the connection is still open."""
        try:
            while self.waiting:
                self.socket.send(self.waiting[0])
                self.waiting.popleft()
        except BlockingIOError:
            return True
        except OSError:
            return False
        return not self.closing


def late(connection: ClientConnection, now: float) -> bool:
    """Returns whether a connection has no role, or does not read its Goodbye, after HELLO_TIMEOUT."""
    return connection.place == "silent" and now - connection.since >= HELLO_TIMEOUT


def superfluous(connections: Iterable[ClientConnection]) -> Iterator[ClientConnection]:
    """Yields the connections that are too many for PLACES.

    The process with the most connections of a kind gives way, with its oldest one. A process with one connection keeps
    its place, however many another process opens.
    """
    every = sorted(connections, key=lambda connection: connection.client.number)
    for place, places in PLACES.items():
        group = [connection for connection in every if connection.place == place]
        counts = Counter(connection.client.pid for connection in group)
        for _ in range(len(group) - places):
            first = max(group, key=lambda connection: counts[connection.client.pid])  # of equals the oldest
            group.remove(first)
            counts[first.client.pid] -= 1
            yield first


class LimitedLog:
    """Writes at most one warning in LINES_EVERY and counts the others."""

    def __init__(self, log: logging.Logger) -> None:
        """Takes the log."""
        self._log, self._next, self._omitted = log, 0.0, 0

    def warning(self, text: str, now: float) -> None:
        """Writes a warning at a time [s], or counts it."""
        if now < self._next:
            self._omitted += 1
            return
        more = f" ({self._omitted} warnings like this were not written)" if self._omitted else ""
        self._log.warning("%s%s", text, more)
        self._next, self._omitted = now + LINES_EVERY, 0
