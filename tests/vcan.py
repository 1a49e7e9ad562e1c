"""Virtual CAN interfaces of the kernel, for tests on SocketCAN."""

import functools
import itertools
import os
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import can
from can.interfaces.socketcan import SocketcanBus

_SO_RCVBUFFORCE = 33  # of asm-generic/socket.h, which Python does not name; beyond the system's bound, for root
_NUMBERS = itertools.count()


@dataclass(frozen=True)
class Interface:
    """A vcan interface of the kernel; what happens to it is what a user does with `ip link`.

    Attributes:
        name: as in `ip link`, the channel of python-can's socketcan.
    """

    name: str

    def make(self) -> None:
        """Adds it, and brings it up."""
        _link("add", "dev", self.name, "type", "vcan")
        self.up()

    def up(self) -> None:
        _link("set", "dev", self.name, "up")

    def down(self) -> None:
        _link("set", "dev", self.name, "down")

    def delete(self) -> None:
        """Takes it away, as a USB adapter that is unplugged."""
        _link("delete", "dev", self.name)


@contextmanager
def made() -> Iterator[Interface]:
    """An interface that is up and nobody else's; it is gone afterwards."""
    interface = Interface(f"vcan{os.getpid()}-{next(_NUMBERS)}")
    interface.make()
    try:
        yield interface
    finally:
        if os.path.exists(f"/sys/class/net/{interface.name}"):
            interface.delete()


@functools.cache
def missing() -> str | None:
    """Why no vcan can be made here, or None if it can."""
    try:
        with made():
            return None
    except OSError as error:
        return f"no vcan interface can be made here: {error}"


def make_room(bus: can.BusABC) -> None:
    """Lets a bus of the kernel hold all that comes until the test looks; the virtual one does."""
    if isinstance(bus, SocketcanBus):
        bus.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, 64 << 20)


def _link(*words: str) -> None:
    """Runs `ip link`.

    Raises:
        OSError: it is not there, or fails; with its words.
    """
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    done = subprocess.run(["ip", "link", *words], capture_output=True, text=True, env={"PATH": path})
    if done.returncode != 0:
        raise OSError(done.stderr.strip())
