"""Notifications to systemd: sd_notify(3), one datagram each."""

import contextlib
import os
import socket
from array import array
from typing import IO

FIRST = 3  # number of the first file that systemd passes on, see sd_listen_fds(3)


class Notifier:
    """Sends assignments to $NOTIFY_SOCKET; sends nothing if systemd did not start the process.

    `watchdog` is the longest time between two watchdog messages [s]; None if the watchdog is off.
    """

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) if address else None
        usec = os.environ.get("WATCHDOG_USEC", "")
        self.watchdog = int(usec) / 1e6 if usec.isdecimal() and address else None

    def notify(self, assignment: str) -> None:
        if self._socket is None:
            return
        line = " ".join(assignment.splitlines())  # a line break would begin another assignment
        with contextlib.suppress(OSError):  # systemd receives the next one
            self._socket.sendto(line.encode(errors="replace"), self._address)

    def kept_file(self, name: str) -> IO[bytes] | None:
        """Returns a file in memory that outlives the process; None if systemd did not start the process.

        systemd keeps it while it restarts the service, if the unit has `FileDescriptorStoreMax`. `name` has letters and
        hyphens.
        """
        if self._socket is None:
            return None
        names = os.environ.get("LISTEN_FDNAMES", "").split(":")
        if os.environ.get("LISTEN_PID") == str(os.getpid()) and name in names:
            number = FIRST + names.index(name)
            os.set_inheritable(number, False)
            return os.fdopen(number, "r+b", buffering=0)
        file = os.fdopen(os.memfd_create(name), "r+b", buffering=0)
        with contextlib.suppress(OSError):
            rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array("i", [file.fileno()]))]
            self._socket.sendmsg([f"FDSTORE=1\nFDNAME={name}".encode()], rights, 0, self._address)
        return file
