"""The lock of a CAN interface: one program of a computer owns it, from the first frame until it ends."""

from __future__ import annotations

import socket
import struct

from hyperbit.drivers.canopen.faults import BusError


class InterfaceInUse(BusError):
    """Another process of this computer owns the interface."""


def lock_interface(channel: str) -> socket.socket:
    """Returns what holds the lock of a SocketCAN interface until it is closed, or until the process ends.

    It is a Unix socket in the abstract namespace, which belongs to a network namespace as interfaces do.

    Raises:
        InterfaceInUse: another process holds it; the text names the process.
    """
    address = f"\0hyperbit/can/{channel}"
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        lock.bind(address)
    except OSError:
        with lock:
            raise InterfaceInUse(f"process {_owner(lock, address)} of hyperbit uses {channel}: stop it first") from None
    lock.listen()
    return lock


def _owner(client: socket.socket, address: str) -> int | str:
    """Returns the id of the process that listens at an address."""
    try:
        client.connect(address)
    except OSError:
        return "(unknown)"
    size = struct.calcsize("3i")
    pid: int = struct.unpack("3i", client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))[0]
    return pid
