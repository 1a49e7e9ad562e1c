"""The executor's socket: its clients and their messages. Nothing here blocks."""

import logging
import os
import socket
import struct
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Literal

from hyperbit.controller import program
from hyperbit.controller.executor.core.events import ClientGone, ClientId, FromClient
from hyperbit.controller.host.keeper import lock_file

log = logging.getLogger(__name__)
BACKLOG = 128  # connections that wait to be accepted
MOST_ACCEPTED = 16  # connections in one poll, so that a flood of them does not block the loop
MOST_MESSAGES = 64  # of all clients in one poll, about, so that a flood does not block the loop
LEAST_MESSAGES = 4  # of one client in one poll
MOST_QUEUED = 1_000  # waiting messages of a client; above this number it is disconnected
HELLO_TIMEOUT = 1.0  # [s] from the connection to its Hello
PLACES = {"silent": 16, "operator": 15}  # the core refuses a second planner, and its connection ends at once
LINES_EVERY = 1.0  # [s] between two lines of the log
CREDENTIALS = struct.Struct("3i")  # SO_PEERCRED: pid, uid, gid


class ClientConnection:
    """The connection of one client since the time `since` [s], with the messages that wait to be sent."""

    def __init__(self, number: int, connected: socket.socket, now: float) -> None:
        connected.setblocking(False)
        options = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
        self.client = ClientId(number, CREDENTIALS.unpack(options)[0])
        self.socket, self.since = connected, now
        self.waiting: deque[bytes] = deque()
        # by its Hello, None before; a commissioner takes the place of a planner
        # by its Hello, None before; a commissioner takes the place of a planner
        self.role: Literal["planner", "operator"] | None = None
        self.closing = False  # whether a Goodbye was sent

    @property
    def place(self) -> str:
        """Kind of place that the connection takes: "silent", "operator" or "planner"."""
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
    """Returns whether a connection, after HELLO_TIMEOUT, has no role or does not read its Goodbye."""
    return connection.place == "silent" and now - connection.since >= HELLO_TIMEOUT


def superfluous(connections: Iterable[ClientConnection]) -> Iterator[ClientConnection]:
    """Yields the connections that are too many for PLACES.

    The process with the most connections of a kind loses its oldest one. A process with one connection keeps its place,
    however many another process opens.
    """
    every = sorted(connections, key=lambda connection: connection.client.number)
    for place, places in PLACES.items():
        group = [connection for connection in every if connection.place == place]
        counts = Counter(connection.client.pid for connection in group)
        for _ in range(len(group) - places):
            first = max(group, key=lambda connection: counts[connection.client.pid])  # the oldest of equals
            group.remove(first)
            counts[first.client.pid] -= 1
            yield first


class ExecutorServer:
    """Listens on a Unix socket of the type SOCK_SEQPACKET. A locked file "<path>.lock" excludes a second executor.

    Snapshots and diagnostics are dropped for a client that does not read; other messages are queued. Connections before
    their Hello, operators, and the planner have places of their own, see `PLACES`.

    Raises FileInUse, which names the other executor's process, or OSError.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self.dropped = 0  # number of dropped snapshots and diagnostics
        self._clock = clock
        self._next_line, self._omitted = 0.0, 0  # earliest time of the next log line, and number of omitted lines
        self._path, self._number = path, 0
        self._connections: dict[ClientId, ClientConnection] = {}
        self._gone: list[ClientId] = []
        self._buffer = memoryview(bytearray(program.MOST_BYTES + 1))
        self._lock = lock_file(path.with_name(path.name + ".lock"), f"an executor is running on {path}, process")
        path.unlink(missing_ok=True)
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        try:
            self._listening.bind(str(path))
        except OSError as error:  # the path has more than 107 bytes, or the disk is full; the error names no file
            raise OSError(f"the socket {path} cannot be made: {error}") from None
        path.chmod(0o660)  # the folder decides who may connect
        self._listening.listen(BACKLOG)

    def readable(self) -> list[int]:
        return [self._listening.fileno(), *(c.socket.fileno() for c in self._connections.values())]

    def writable(self) -> list[int]:
        return [c.socket.fileno() for c in self._connections.values() if c.waiting]

    def poll(self, ready: Collection[int] | None = None) -> list[FromClient | ClientGone]:
        """Returns what the clients sent since the last call; `ready`: readable file descriptors, None: try all."""
        now = self._clock()
        events: list[FromClient | ClientGone] = []
        known = list(self._connections.values())
        if ready is None or self._listening.fileno() in ready:
            self._accept(events, now)
            ready = None
        for connection in known:
            if ready is None or connection.socket.fileno() in ready or late(connection, now):
                self._read(connection, events)
            if late(connection, now) and connection.client in self._connections:
                self._close(connection, "it said no Hello, or read no Goodbye, in time", now)
        events += [ClientGone(client) for client in self._gone]
        self._gone = []
        return events

    def send_message(self, client: ClientId, message: program.Up) -> None:
        connection = self._connections.get(client)
        if connection is None or connection.closing:
            return
        data = program.encode(message)
        telemetry = isinstance(message, program.Snapshot | program.Diagnostics)
        if len(data) > program.MOST_BYTES or (telemetry and connection.waiting):
            self.dropped += 1
            return
        connection.waiting.append(data)
        connection.closing = isinstance(message, program.Goodbye)
        if not connection.flush() or len(connection.waiting) > MOST_QUEUED:
            self._drop(connection)

    def flush(self) -> None:
        for connection in list(self._connections.values()):
            if connection.waiting and not connection.flush():
                self._drop(connection)

    @property
    def waiting(self) -> bool:
        return any(connection.waiting for connection in self._connections.values())

    def close(self) -> None:
        for connection in list(self._connections.values()):
            self._drop(connection)
        self._listening.close()
        self._path.unlink(missing_ok=True)
        os.close(self._lock)

    def _accept(self, events: list[FromClient | ClientGone], now: float) -> None:
        for _ in range(MOST_ACCEPTED):
            try:
                connected, _ = self._listening.accept()
            except BlockingIOError:
                return
            except OSError as error:  # out of file descriptors
                self._warn(f"a client cannot connect: {error}", now)
                return
            self._number += 1
            connection = ClientConnection(self._number, connected, now)
            self._connections[connection.client] = connection
            self._read(connection, events)
            self._make_room(events, now)

    def _make_room(self, events: list[FromClient | ClientGone], now: float) -> None:
        """Closes superfluous connections. Each is read first: its Hello may wait."""
        for connection in superfluous(self._connections.values()):
            self._read(connection, events)
        for connection in superfluous(self._connections.values()):
            self._close(connection, f"too many {connection.place} connections", now)

    def _read(self, connection: ClientConnection, events: list[FromClient | ClientGone]) -> None:
        for _ in range(max(LEAST_MESSAGES, MOST_MESSAGES // len(self._connections))):
            try:
                size = connection.socket.recv_into(self._buffer)
            except BlockingIOError:
                return
            except OSError:
                size = 0
            if size == 0:
                self._drop(connection)
                return
            try:
                message = program.decode_down(bytes(self._buffer[:size]))
            except program.Malformed as error:
                self._warn(f"process {connection.client.pid}: {error}", self._clock())
                self.send_message(connection.client, program.Goodbye(str(error)[:1_000]))
                return
            if not connection.closing:
                if isinstance(message, program.Hello):
                    connection.role = "operator" if message.role == "operator" else "planner"
                events.append(FromClient(connection.client, message))

    def _close(self, connection: ClientConnection, why: str, now: float) -> None:
        self._warn(f"the connection of process {connection.client.pid} is closed: {why}", now)
        self._drop(connection)

    def _drop(self, connection: ClientConnection) -> None:
        if self._connections.pop(connection.client, None) is not None:
            connection.socket.close()
            self._gone.append(connection.client)

    def _warn(self, text: str, now: float) -> None:
        """Writes at most one warning in LINES_EVERY, and counts the others."""
        if now < self._next_line:
            self._omitted += 1
            return
        more = f" ({self._omitted} warnings like this were not written)" if self._omitted else ""
        log.warning("%s%s", text, more)
        self._next_line, self._omitted = now + LINES_EVERY, 0
