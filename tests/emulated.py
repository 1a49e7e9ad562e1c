"""A CAN interface that works, and fails, as SocketCAN's do, where the kernel has none: between processes, too.

What is sent is forwarded by a thread of the test's process, over sockets that keep frames whole. Importing this module
tells python-can of the interface "emulated".
"""

import errno
import mmap
import os
import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import can
import can.interfaces

FRAME = struct.Struct("<IB8s?d")  # identifier with SocketCAN's flags, length, data, whether the receiver's own, when
EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
UP, DOWN, GONE = range(3)
BUS_OFF, RESTARTED = 0x40, 0x100  # classes of error frames
QUEUE = 10  # frames; the kernel's own default of txqueuelen

can.interfaces.BACKENDS["emulated"] = ("tests.emulated", "EmulatedBus")


class Interface:
    """An interface that is up. The frames of those who ask for their own back are sent through its queue: the daemon's.

    Attributes:
        channel: of python-can.
        on_sent: called with identifier and data of each frame that was sent through the queue, before it is forwarded.
    """

    def __init__(self, folder: Path) -> None:
        self.channel = str(folder)
        self.on_sent: Callable[[int, bytes], None] = lambda cob_id, data: None
        (folder / "state").write_bytes(bytes(2))
        self._state = _mapped(folder)
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(folder / "socket"))
        self._server.listen()
        self._clients: dict[socket.socket, bool] = {}  # and whether their frames are queued, and come back
        self._queue: deque[tuple[socket.socket, bytes]] = deque()
        self._held = self._off = self._closing = False
        self._lock = threading.RLock()
        self._thread = threading.Thread(target=self._run, name="emulated CAN", daemon=True)
        self._thread.start()

    def down(self) -> None:
        self._state[0] = DOWN

    def up(self) -> None:
        self._state[0] = UP

    def delete(self) -> None:
        with self._lock:
            self._state[0] = GONE
            for client in list(self._clients):
                self._drop(client)

    def make(self) -> None:
        self._state[0] = UP

    def hold(self) -> None:
        """Lets none of the daemon's frames leave: others have the bus, which still brings theirs."""
        with self._lock:
            self._held = True

    def release(self) -> None:
        with self._lock:
            self._held = self._off = False
            while self._queue:
                self._forward(*self._queue.popleft())
            self._state[1] = 0

    def bus_off(self) -> None:
        """Takes the daemon's controller off the bus; what is queued stays so."""
        with self._lock:
            self._held = self._off = True
            self.tell(BUS_OFF)

    def restart(self) -> None:
        """Restarts its controller: what is queued leaves."""
        with self._lock:
            self.release()
            self.tell(RESTARTED)

    def tell(self, kind: int, detail: int = 0, tx_errors: int = 0, rx_errors: int = 0) -> None:
        data = bytes([0, detail, 0, 0, 0, 0, tx_errors, rx_errors])
        with self._lock:
            for client, queued in self._clients.items():
                if queued:
                    _send(client, FRAME.pack(kind | ERROR, 8, data, False, time.time()))

    def flush(self) -> None:
        """Forwards what was sent before the call."""
        with self._lock:
            while readable := [it for it in select.select([*self._clients], [], [], 0)[0] if it in self._clients]:
                for client in readable:
                    self._take(client)

    def close(self) -> None:
        self._closing = True
        self._thread.join()
        self.delete()
        self._server.close()

    def _run(self) -> None:
        while not self._closing:
            with self._lock:
                waiting = [self._server, *self._clients]
            try:
                readable, _, _ = select.select(waiting, [], [], 0.05)
            except (OSError, ValueError):  # one was closed meanwhile
                continue
            with self._lock:
                for it in readable:
                    if it is self._server:
                        client, _ = it.accept()
                        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 << 20)
                        self._clients[client] = client.recv(1) == b"\1"
                    elif it in self._clients:
                        self._take(it)

    def _take(self, client: socket.socket) -> None:
        try:
            packet = client.recv(FRAME.size, socket.MSG_DONTWAIT)
        except BlockingIOError:  # `flush` has taken it
            return
        except OSError:
            packet = b""
        if not packet:
            self._drop(client)
        elif self._held and self._clients[client]:
            self._queue.append((client, packet))
            self._state[1] = min(len(self._queue), 255)
        else:
            self._forward(client, packet)

    def _forward(self, sender: socket.socket, packet: bytes) -> None:
        if self._state[0] != UP:
            return
        identifier, length, data, _, _ = FRAME.unpack(packet)
        now = time.time()
        if self._clients.get(sender, True):
            self.on_sent(identifier, data[:length])
        for client, queued in self._clients.items():
            own = client is sender
            if queued if own else not (queued and self._off):
                _send(client, FRAME.pack(identifier, length, data, own, now))

    def _drop(self, client: socket.socket) -> None:
        del self._clients[client]
        client.close()


class EmulatedBus(can.BusABC):
    """The other side of an Interface, with the errors of python-can's SocketCAN."""

    def __init__(self, channel: str, receive_own_messages: bool = False, **options: Any) -> None:
        self._state = _mapped(Path(channel))
        if self._state[0] == GONE:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        self._queued, self._orphan = receive_own_messages, False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 << 20)
        self._socket.connect(f"{channel}/socket")
        self._socket.send(b"\1" if receive_own_messages else b"\0")
        self.channel_info = f"emulated {channel}"
        super().__init__(channel=channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._check()
        if self._queued and self._state[1] >= QUEUE:
            raise _failed(errno.ENOBUFS)
        identifier = msg.arbitration_id | EXTENDED * msg.is_extended_id | REMOTE * msg.is_remote_frame
        identifier |= ERROR * msg.is_error_frame
        packet = FRAME.pack(identifier, msg.dlc, bytes(msg.data), False, time.monotonic())  # when it was sent
        try:
            self._socket.send(packet)
        except OSError as error:
            raise _failed(errno.ENODEV) from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._orphan:  # as in the kernel: its own interface will never come back, and that is told once
            time.sleep(0.01 if timeout is None else timeout)
            return None, False
        self._check()
        try:
            packet = self._socket.recv(FRAME.size, 0 if self._readable(timeout) else socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None, False
        except OSError:
            packet = b""
        if not packet:
            self._orphan = True
            raise _failed(errno.ENODEV)
        identifier, length, data, own, stamp = FRAME.unpack(packet)
        message = can.Message(
            timestamp=stamp,
            arbitration_id=identifier & (0x1FFFFFFF if identifier & EXTENDED else 0x7FF),
            is_extended_id=bool(identifier & EXTENDED),
            is_remote_frame=bool(identifier & REMOTE),
            is_error_frame=bool(identifier & ERROR),
            is_rx=not own,
            dlc=length,
            data=data[:length],
        )
        return message, False

    def _readable(self, timeout: float | None) -> bool:
        """Waits for a packet; returns False at once where none is to be waited for."""
        return timeout != 0 and bool(select.select([self._socket], [], [], timeout)[0])

    def fileno(self) -> int:
        return self._socket.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self._socket.close()

    def _check(self) -> None:
        if self._state[0] != UP:
            self._orphan |= self._state[0] == GONE
            raise _failed(errno.ENETDOWN if self._state[0] == DOWN else errno.ENODEV)


def _mapped(folder: Path) -> mmap.mmap:
    """What all processes know of an interface: whether it is there and up, and how many frames are queued."""
    with (folder / "state").open("r+b") as file:
        return mmap.mmap(file.fileno(), 2)


def _send(client: socket.socket, packet: bytes) -> None:
    with suppress(OSError):  # who does not read loses frames, as in the kernel
        client.send(packet, socket.MSG_DONTWAIT)


def _failed(code: int) -> can.CanOperationError:
    return can.CanOperationError(f"Failed: {os.strerror(code)}", code)
