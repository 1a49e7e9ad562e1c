"""The executor's socket: its clients and their messages. Nothing here blocks."""

import contextlib
import fcntl
import logging
import os
import socket
import struct
from collections import deque
from collections.abc import Collection
from pathlib import Path

from controller.executor.events import Client, ClientGone, FromClient
from controller.program import MOST_BYTES, Diagnostics, Goodbye, Malformed, Snapshot, Up, decode_down, encode

log = logging.getLogger(__name__)

MOST_CLIENTS = 16
MOST_MESSAGES = 64  # of one client in one poll, so that a flood does not block the loop
MOST_QUEUED = 1_000  # messages that wait for a client that does not read; it is disconnected with more
CREDENTIALS = struct.Struct("3i")  # SO_PEERCRED: pid, uid, gid


class SocketInUse(Exception):
    """Another executor uses the socket."""


class Connection:
    """The connection of one client, with the messages that wait to be sent."""

    def __init__(self, number: int, connected: socket.socket) -> None:
        """Takes the number of the connection and its socket."""
        connected.setblocking(False)
        options = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
        self.client = Client(number, CREDENTIALS.unpack(options)[0])
        self.socket = connected
        self.waiting: deque[bytes] = deque()
        self.closing = False  # after a Goodbye

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


class Server:
    """Listens on a Unix socket of the type SOCK_SEQPACKET.

    Snapshots and diagnostics are dropped for a client that does not read; other messages are queued.

    Attributes:
        dropped: number of dropped snapshots and diagnostics.

    Args:
        path: of the socket. A locked file beside it, with the suffix ".lock", excludes a second executor.

    Raises:
        SocketInUse: another executor listens there; the text names its process.
        OSError: the socket cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.dropped = 0
        self._path, self._number = path, 0
        self._connections: dict[Client, Connection] = {}
        self._gone: list[Client] = []
        self._buffer = memoryview(bytearray(MOST_BYTES + 1))
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._lock = lock(path.with_name(path.name + ".lock"))
        path.unlink(missing_ok=True)
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._listening.bind(str(path))
        path.chmod(0o660)  # the folder decides who may connect
        self._listening.listen(MOST_CLIENTS)

    def readable(self) -> list[int]:
        """Returns the file descriptors to wait on for `poll`."""
        return [self._listening.fileno(), *(c.socket.fileno() for c in self._connections.values())]

    def writable(self) -> list[int]:
        """Returns the file descriptors to wait on until they can be written, for `flush`."""
        return [c.socket.fileno() for c in self._connections.values() if c.waiting]

    def poll(self, ready: Collection[int] | None = None) -> list[FromClient | ClientGone]:
        """Returns what the clients sent since the last call.

        Args:
            ready: readable file descriptors; None: try all.
        """
        if ready is None or self._listening.fileno() in ready:
            self._accept()
            ready = None
        events: list[FromClient | ClientGone] = []
        for connection in list(self._connections.values()):
            if (ready is None or connection.socket.fileno() in ready) and not self._read(connection, events):
                self._drop(connection)
        events += [ClientGone(client) for client in self._gone]
        self._gone = []
        return events

    def send(self, client: Client, message: Up) -> None:
        """Sends a message to a client, or queues it."""
        connection = self._connections.get(client)
        if connection is None or connection.closing:
            return
        data = encode(message)
        telemetry = isinstance(message, Snapshot | Diagnostics)
        if len(data) > MOST_BYTES or (telemetry and connection.waiting):
            self.dropped += 1
            return
        connection.waiting.append(data)
        connection.closing = isinstance(message, Goodbye)
        if not connection.flush() or len(connection.waiting) > MOST_QUEUED:
            self._drop(connection)

    def flush(self) -> None:
        """Sends what waits."""
        for connection in list(self._connections.values()):
            if connection.waiting and not connection.flush():
                self._drop(connection)

    @property
    def waiting(self) -> bool:
        """Whether anything waits to be sent."""
        return any(connection.waiting for connection in self._connections.values())

    def close(self) -> None:
        """Closes all connections and removes the socket."""
        for connection in list(self._connections.values()):
            self._drop(connection)
        self._listening.close()
        self._path.unlink(missing_ok=True)
        os.close(self._lock)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                try:
                    connected, _ = self._listening.accept()
                except BlockingIOError:
                    raise
                except OSError as error:  # out of file descriptors
                    log.warning("a client cannot connect: %s", error)
                    return
                if len(self._connections) >= MOST_CLIENTS:
                    connected.close()
                    continue
                self._number += 1
                connection = Connection(self._number, connected)
                self._connections[connection.client] = connection

    def _read(self, connection: Connection, events: list[FromClient | ClientGone]) -> bool:
        """Reads the messages of a client; returns whether the connection is still open."""
        for _ in range(MOST_MESSAGES):
            try:
                size = connection.socket.recv_into(self._buffer)
            except BlockingIOError:
                return True
            except OSError:
                return False
            if size == 0:
                return False
            try:
                message = decode_down(bytes(self._buffer[:size]))
            except Malformed as error:
                log.warning("process %d: %s", connection.client.pid, error)
                self.send(connection.client, Goodbye(str(error)[:1_000]))
                return not connection.closing
            if not connection.closing:
                events.append(FromClient(connection.client, message))
        return True

    def _drop(self, connection: Connection) -> None:
        if self._connections.pop(connection.client, None) is not None:
            connection.socket.close()
            self._gone.append(connection.client)


def lock(path: Path) -> int:
    """Locks a file, writes the process id into it, and returns its file descriptor.

    Raises:
        SocketInUse: another process has locked the file.
    """
    number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        pid = os.pread(number, 32, 0).decode(errors="replace").strip() or "unknown"
        os.close(number)
        raise SocketInUse(f"an executor is running on {path.with_suffix('')}, process {pid}") from None
    os.ftruncate(number, 0)
    os.pwrite(number, b"%d\n" % os.getpid(), 0)
    return number
