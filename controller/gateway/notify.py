"""Messages to systemd: sd_notify(3), one datagram each."""

import contextlib
import os
import socket


class Notifier:
    """Sends states to $NOTIFY_SOCKET; does nothing if the variable is not set."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) if address else None

    def send(self, *states: str) -> None:
        """Sends assignments such as "READY=1"."""
        if self._socket is None:
            return
        with contextlib.suppress(OSError):  # the next message tells as much
            lines = (" ".join(state.splitlines()) for state in states)  # a line break would begin another assignment
            self._socket.sendto("\n".join(lines).encode(errors="replace"), self._address)
