"""An operator at the executor's socket: receives the executor's messages without planner and Zenoh."""

import socket
import threading
from contextlib import suppress
from pathlib import Path

from hyperbit.controller.program import VERSION, Diagnostics, Hello, Snapshot, Up, Welcome, decode_up, encode
from tests.waiting import eventually


class Operator:
    """A client in the role "operator" that remembers its messages."""

    def __init__(self, path: Path) -> None:
        self.heard: list[Up] = []
        self._socket = eventually(lambda: connected(path))
        self._socket.send(encode(Hello(VERSION, "operator", "")))
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Operator":
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()

    def snapshot(self) -> Snapshot:
        before = len(self.heard)
        return eventually(lambda: next((it for it in self.heard[before:] if isinstance(it, Snapshot)), None))

    def wait_for(self, mode: str) -> Snapshot:
        while (snapshot := self.snapshot()).mode != mode:
            pass
        return snapshot

    def counts(self) -> list[int]:
        before = len(self.heard)
        found = eventually(lambda: next((it for it in self.heard[before:] if isinstance(it, Diagnostics)), None))
        return list(found.counts)

    def welcome(self) -> Welcome:
        return eventually(lambda: next((it for it in self.heard if isinstance(it, Welcome)), None))

    def _listen(self) -> None:
        with suppress(OSError):
            while data := self._socket.recv(1 << 17):
                self.heard.append(decode_up(data))


def connected(path: Path) -> socket.socket | None:
    """A connected socket; None if no executor listens there."""
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        client.connect(str(path))
    except OSError:
        client.close()
        return None
    return client
