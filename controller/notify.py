"""Notifications to systemd: sd_notify(3), one datagram each."""

import contextlib
import os
import socket


class Notifier:
    """Sends assignments to $NOTIFY_SOCKET; sends nothing if systemd did not start the process.

    Attributes:
        watchdog: longest time between two watchdog messages [s]; None if the watchdog is off.
    """

    def __init__(self) -> None:
        """Reads $NOTIFY_SOCKET and $WATCHDOG_USEC."""
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) if address else None
        usec = os.environ.get("WATCHDOG_USEC", "")
        self.watchdog = int(usec) / 1e6 if usec.isdecimal() and address else None

    def send(self, assignment: str) -> None:
        """Sends an assignment such as "READY=1"."""
        if self._socket is None:
            return
        line = " ".join(assignment.splitlines())  # a line break would begin another assignment
        with contextlib.suppress(OSError):  # systemd receives the next one
            self._socket.sendto(line.encode(errors="replace"), self._address)
