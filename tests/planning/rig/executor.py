"""An executor that the test plays, on a real socket, and the other parts that a planner needs."""

import contextlib
import queue
import socket
import threading
import time
from pathlib import Path
from typing import Any

from hyperbit.controller.program import (
    Alive,
    Counts,
    Down,
    Hello,
    PlayableFaults,
    Up,
    Welcome,
    decode_down,
    encode,
)
from tests.planning.rig.played_executor import PlayedExecutor
from tests.waiting import PATIENCE

DIGEST = "d" * 64


class ScriptedExecutor(PlayedExecutor):
    """Listens on a socket. The test receives each message with `expect`, and answers it.

    Attributes:
        state: the latest snapshot; `show` changes and sends it.
        greets: whether a planner's Hello is answered by Welcome.
        simulation: the simulated boards of the next Welcome; None: real boards.
    """

    def __init__(self, path: Path, actuators: int, name: str = "small") -> None:
        super().__init__(actuators)
        self.name, self.greets, self.greatest = name, True, 0
        self.simulation: PlayableFaults | None = None
        self._messages: queue.Queue[Down] = queue.Queue()
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(path))
        self._server.listen()
        self.client: socket.socket | None = None
        self._greeted = False
        self._closing, self._lock = threading.Event(), threading.Lock()
        for work in (self._serve, self._stay_alive):
            threading.Thread(target=work, daemon=True).start()

    def now(self) -> float:
        return time.monotonic()

    def send(self, message: Up) -> None:
        assert self.client is not None
        self.client.send(encode(message))

    def take(self) -> Down:
        return self._messages.get(timeout=PATIENCE)

    def waiting(self) -> list[Down]:
        return list(self._messages.queue)

    def show(self, **changes: Any) -> None:
        with self._lock:
            super().show(**changes)

    def drop(self) -> None:
        assert self.client is not None
        self.client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._closing.set()
        self._server.close()
        if self.client is not None:
            self.client.close()

    def _stay_alive(self) -> None:
        """Repeats the snapshot, so that the executor does not count as silent."""
        while not self._closing.wait(0.2):
            with self._lock, contextlib.suppress(OSError):
                if self._greeted and self.client is not None:
                    self.client.send(encode(self.state))

    def _serve(self) -> None:
        while not self._closing.is_set():
            try:
                self._greeted = False
                self.client, _ = self._server.accept()
                self._listen(self.client)
            except OSError:
                continue

    def _listen(self, client: socket.socket) -> None:
        while data := client.recv(70_000):
            match message := decode_down(data):
                case Hello():
                    if self.greets:
                        size = (0,) * self.actuators
                        self.send(Welcome(self.name, DIGEST, self.instance, size, self.greatest, self.simulation))
                        self.send(self.state)
                        self._greeted = True
                    self._messages.put(message)
                case Alive() | Counts():
                    pass
                case _:
                    self._messages.put(message)
