"""Virtual CAN interfaces of the kernel, for tests on SocketCAN."""

import functools
import itertools
import os
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import can
from can.interfaces.socketcan import SocketcanBus

from tests.emulated import BUS_OFF, QUEUE, RESTARTED

_SO_RCVBUFFORCE = 33  # of asm-generic/socket.h, which Python does not name; beyond the system's bound, for root
_NUMBERS = itertools.count()


# Of sockets (SO_PRIORITY): the kernel's queueing discipline "prio" lets the first leave before those that say nothing,
# and the last after them, as a bus does by identifiers.
FIRST, LAST = 6, 1
_DAEMON, _OTHERS = "1:2", "1:1"  # their classes
_FRAME = 16  # bytes, of a frame in the kernel's queues


@dataclass(frozen=True)
class Interface:
    """A vcan interface of the kernel; what happens to it is what a user does with `ip link` and `tc`.

    What leaves at once and what waits is told by the sender's socket: the daemon's frames are those of no priority.
    """

    name: str

    def make(self) -> None:
        _run("ip", "link", "add", "dev", self.name, "txqueuelen", "128", "type", "vcan")
        self.up()

    def up(self) -> None:
        _run("ip", "link", "set", "dev", self.name, "up")

    def down(self) -> None:
        _run("ip", "link", "set", "dev", self.name, "down")

    def delete(self) -> None:
        _run("ip", "link", "delete", "dev", self.name)

    def hold(self) -> None:
        """Lets none of the daemon's frames leave: others have the bus, which still brings theirs."""
        self._queue("handle", "1:", "prio")
        self._plug(_DAEMON)

    def release(self) -> None:
        self._unplug(_DAEMON)

    def bus_off(self) -> None:
        """Tells that the controller is off the bus, which is held already; from then on nothing comes, either."""
        self.tell(BUS_OFF)
        self._plug(_OTHERS)

    def restart(self) -> None:
        self._unplug(_OTHERS)
        self.release()
        self.tell(RESTARTED)

    def flush(self) -> None:
        """Does nothing: the kernel forwards a frame before the sender's call returns."""

    def tell(self, kind: int, detail: int = 0, tx_errors: int = 0, rx_errors: int = 0) -> None:
        data = bytes([0, detail, 0, 0, 0, 0, tx_errors, rx_errors])
        with can.Bus(interface="socketcan", channel=self.name, ignore_config=True) as bus:
            give_way(bus, FIRST)
            bus.send(can.Message(arbitration_id=kind, is_error_frame=True, is_extended_id=False, data=data))

    def bound(self, bitrate: float) -> None:
        """Limits the interface to a bit rate [bit/s]; frames of the lowest priority wait."""
        rate = f"{round(bitrate / 135 * 8 * _FRAME)}bit"  # a frame of 8 bytes has up to 135 bits on the wire
        self._queue("handle", "2:", "tbf", "rate", rate, "burst", str(4 * _FRAME), "limit", str(128 * _FRAME))
        _run("tc", "qdisc", "add", "dev", self.name, "parent", "2:1", "handle", "1:", "prio")

    def _queue(self, *words: str) -> None:
        """Gives it a queue, in place of one of an earlier test."""
        if any(f" {handle} root" in _run("tc", "qdisc", "show", "dev", self.name) for handle in ("1:", "2:")):
            _run("tc", "qdisc", "del", "dev", self.name, "root")
        _run("tc", "qdisc", "add", "dev", self.name, "root", *words)

    def _plug(self, parent: str) -> None:
        words = ("parent", parent, "plug", "limit", str(QUEUE * _FRAME))
        _run("tc", "qdisc", "add", "dev", self.name, *words)

    def _unplug(self, parent: str) -> None:
        _run("tc", "qdisc", "change", "dev", self.name, "parent", parent, "plug", "release_indefinite")


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


@functools.cache
def queueless() -> str | None:
    """Why frames of a vcan never wait in a queue here, or None if they do."""
    if Path("/sys/module/vcan/parameters/echo").read_text().strip() != "Y":
        return "vcan delivers frames before they are queued here, but for: modprobe -r vcan && modprobe vcan echo=1"
    try:
        with made() as interface:
            interface.hold()
            return None
    except OSError as error:
        return f"no queue can be held here: {error}"


def give_way(bus: can.BusABC, priority: int) -> None:
    """Sets the priority of a socket's frames on the kernel's bus; an emulated bus has no priorities."""
    if isinstance(bus, SocketcanBus):
        bus.socket.setsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY, priority)


def make_room(bus: can.BusABC) -> None:
    """Lets a bus of the kernel hold all that comes until the test looks; the virtual one does."""
    if isinstance(bus, SocketcanBus):
        bus.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, 64 << 20)


def _run(*words: str) -> str:
    """Runs `ip` or `tc`; returns what it prints."""
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    done = subprocess.run(words, capture_output=True, text=True, env={"PATH": path})
    if done.returncode != 0:
        raise OSError(f"{' '.join(words)}: {done.stderr.strip()}")
    return done.stdout
