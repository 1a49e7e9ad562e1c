"""The executor's core in a thread, on boards in memory and a real socket."""

import contextlib
import select
import socket
import threading
import time
from pathlib import Path

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ClientGone, ClientId, ExecutorTick, FromClient, ToClient
from hyperbit.controller.program import TICK, decode_down, encode
from tests.executor.rig import SIZE, FakeMaster, small_arm
from tests.planning.rig.executor import DIGEST


class CoreExecutor:
    """Serves one planner at a time until it is closed.

    Attributes:
        core: used by its own thread only; other threads may read.
        frozen: while set, the executor does nothing, like a stopped process.
    """

    def __init__(self, path: Path) -> None:
        arm: ExecutedArm = small_arm()
        assert arm.digest == DIGEST
        self.journal = SwitchJournal(SIZE)
        self.core = Executor(arm, self.journal, instance=1, build_master=FakeMaster)
        self.master: FakeMaster = self.core.master  # type: ignore[assignment]
        self.frozen, self.closed = threading.Event(), threading.Event()
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(path))
        self._server.listen()
        self._clients: dict[ClientId, socket.socket] = {}
        self._accepted = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self.closed.set()
        self._thread.join()
        self._server.close()
        for connection in self._clients.values():
            connection.close()

    def _run(self) -> None:
        due = time.monotonic()
        while not self.closed.is_set():
            if self.frozen.is_set():
                time.sleep(TICK)
                continue
            self._listen(max(due - time.monotonic(), 0.0))
            if time.monotonic() >= due:
                due = time.monotonic() + TICK
                self._do(ExecutorTick())

    def _listen(self, timeout: float) -> None:
        sockets = [self._server, *self._clients.values()]
        readable, _, _ = select.select(sockets, [], [], timeout)
        if self._server in readable:
            connection, _ = self._server.accept()
            self._accepted += 1
            self._clients[ClientId(self._accepted, 1)] = connection
        for client, connection in list(self._clients.items()):
            if connection in readable:
                if data := received(connection):
                    self._do(FromClient(client, decode_down(data)))
                else:
                    del self._clients[client]
                    connection.close()
                    self._do(ClientGone(client))

    def _do(self, event: object) -> None:
        for action in self.core.step(event, time.monotonic()):  # type: ignore[arg-type]
            if isinstance(action, ToClient) and action.client in self._clients:
                with contextlib.suppress(OSError):
                    self._clients[action.client].send(encode(action.message), socket.MSG_DONTWAIT)


def received(connection: socket.socket) -> bytes:
    """Returns the next packet; b"" if the planner has closed the connection, with or without unread packets."""
    try:
        return connection.recv(70_000)
    except ConnectionResetError:
        return b""
