"""One connection to the executor's socket. Several threads send, one receives."""

import contextlib
import select
import socket
import threading
from pathlib import Path

from controller.program import MOST_BYTES

CONNECTING = 0.5  # [s]
PATIENCE = 0.2  # [s] that `send` waits for an executor that does not read

FLAGS = socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL


class NotConnected(Exception):
    """No executor is connected; the text says why."""


class Connection:
    """A connected SOCK_SEQPACKET socket.

    Args:
        path: of the executor's socket.

    Raises:
        no process listens there.
    """

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.settimeout(CONNECTING)
            self._socket.connect(str(path))
            self._socket.settimeout(None)
        except OSError as error:
            self._socket.close()
            raise NotConnected(f"waiting for the executor at its socket: {error.strerror or error}") from None

    def send(self, data: bytes) -> None:
        """Sends one packet. For any thread.

        Raises:
            NotConnected: the connection has ended, or the executor does not read.
        """
        with self._lock:
            try:
                self._socket.send(data, FLAGS)
            except BlockingIOError:
                self._send_later(data)
            except OSError as error:
                raise NotConnected(f"the connection to the executor is broken: {error}") from None

    def receive(self) -> bytes:
        """Waits for one packet; returns an empty one if the connection has ended.

        Raises:
            NotConnected: the connection is broken.
        """
        try:
            return self._socket.recv(MOST_BYTES + 1)
        except OSError as error:
            raise NotConnected(f"the connection to the executor is broken: {error}") from None

    def shut(self) -> None:
        """Ends the connection; packets that arrived before can still be received."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Closes the socket. For the receiving thread only."""
        self.shut()
        with self._lock:
            self._socket.close()

    def _send_later(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            if select.select([], [self._socket], [], PATIENCE)[1]:
                self._socket.send(data, FLAGS)
                return
        self.shut()
        raise NotConnected("the executor does not read its messages")
