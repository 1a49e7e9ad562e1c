"""The Zenoh endpoint of `run`: where it listens, or which router it joins; and who has a port that is taken."""

from __future__ import annotations

import contextlib
import glob
import logging
import os
import socket
import threading
from pathlib import Path

log = logging.getLogger(__name__)

LISTENING = "0A"  # state of a socket in /proc/net/tcp
ATTEMPT, PAUSE = 1.0, 0.5  # [s] for one connection, and between two


def address_of(endpoint: str) -> tuple[str, int] | None:
    """Returns host and port of a Zenoh endpoint such as "tcp/127.0.0.1:7447"; None if it has another form."""
    host, _, port = endpoint.partition("?")[0].partition("#")[0].rpartition("/")[2].rpartition(":")
    return (host.strip("[]"), int(port)) if host and port.isascii() and port.isdecimal() else None


def accepts(address: tuple[str, int]) -> bool:
    """Returns whether something accepts connections at an address."""
    with contextlib.suppress(OSError), socket.create_connection(address, timeout=ATTEMPT):
        return True
    return False


def wait_for_router(endpoint: str, ending: threading.Event) -> None:
    """Waits until a router accepts connections, or until the process must end. The arm holds meanwhile."""
    if (address := address_of(endpoint)) is None or accepts(address):
        return
    log.warning("waiting for the Zenoh router at %s: the arm takes no goals before", endpoint)
    while not accepts(address) and not ending.wait(PAUSE):
        pass


def port_taken(endpoint: str) -> str | None:
    """Returns who has the port of an endpoint, and both ways out; None if the port is free or unknown."""
    if (address := address_of(endpoint)) is None or not accepts(address):
        return None
    host, port = address
    who = owner_of(port) or "a process of another user"
    elsewhere = endpoint.replace(f":{port}", f":{port + 1}")
    return (
        f"port {port} of {host} is taken by {who}. If that is a Zenoh router (zenohd, rmw_zenohd), join it by"
        f" --connect {endpoint}; otherwise listen elsewhere by --listen {elsewhere}"
    )


def owner_of(port: int) -> str | None:
    """Returns name and number of the process that listens at a TCP port; None if this user may not see it."""
    inodes = set[str]()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with contextlib.suppress(OSError):
            for line in Path(table).read_text().splitlines()[1:]:
                fields = line.split()
                if fields[3] == LISTENING and int(fields[1].rpartition(":")[2], 16) == port:
                    inodes.add(f"socket:[{fields[9]}]")
    for link in glob.iglob("/proc/[0-9]*/fd/[0-9]*"):  # skips folders of other users, and of processes that end
        with contextlib.suppress(OSError):  # just closed
            if os.readlink(link) in inodes:
                process = Path(link).parents[1]
                return f"{(process / 'comm').read_text().strip()} (process {process.name})"
    return None
