"""Zenoh endpoints: their parts, the wait for a router, and who has a port that is taken."""

from __future__ import annotations

import contextlib
import glob
import logging
import os
import re
import socket
from pathlib import Path
from typing import NamedTuple

from hyperbit.controller.host.signals import Ending

log = logging.getLogger(__name__)

STREAMS = ("tcp", "tls", "ws")  # protocols over TCP
PROTOCOLS = (*STREAMS, "quic", "udp")
LOCAL = ("unixsock-stream", "unixpipe", "vsock", "serial")  # protocols without host and port
HOST_PORT = re.compile(r"(\[[0-9A-Za-z:.%]+\]|[^\s:/\[\]]+):([0-9]{1,5})")
GREATEST_PORT = 65535
START = (
    "start it by: hyperbit run ARM.yaml (--simulate without hardware),"
    " or name its endpoint by --connect or HYPERBIT_CONNECT"
)
LISTENING = "0A"  # state of a socket in /proc/net/tcp
ATTEMPT, PAUSE = 1.0, 0.5  # [s] for one connection, and between two


class Endpoint(NamedTuple):
    """A Zenoh endpoint. Protocols without hosts have the address as `host`, and port 0."""

    protocol: str
    host: str
    port: int

    @property
    def address(self) -> tuple[str, int] | None:
        """Host and port of TCP; None for other protocols."""
        return (self.host, self.port) if self.protocol in STREAMS else None


def parse_endpoint(text: str) -> Endpoint:
    """Returns the parts of an endpoint such as "tcp/127.0.0.1:7447".

    Raises:
        ValueError: the text is none.
    """
    protocol, slash, rest = text.partition("/")
    address = rest.partition("?")[0].partition("#")[0]
    if slash and protocol in LOCAL and address:
        return Endpoint(protocol, address, 0)
    match = HOST_PORT.fullmatch(address)
    if protocol in PROTOCOLS and match is not None and int(match[2]) <= GREATEST_PORT:
        return Endpoint(protocol, match[1].strip("[]"), int(match[2]))
    hint = f"; write tcp/{text}" if HOST_PORT.fullmatch(text) else ""
    if protocol in PROTOCOLS and address.count(":") > 1 and "[" not in address:
        hint = "; an IPv6 address stands in brackets, such as [::1]"
    if slash and protocol not in (*PROTOCOLS, *LOCAL):
        hint = f"; protocols are {', '.join((*PROTOCOLS, *LOCAL))}"
    raise ValueError(f"{text!r} is no endpoint: PROTOCOL/HOST:PORT is needed, such as tcp/127.0.0.1:7447{hint}")


def accepts(address: tuple[str, int]) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(address, timeout=ATTEMPT):
        return True
    return False


def wait_for_router(endpoint: str, ending: Ending) -> None:
    """Waits until a router accepts connections, or until the process must end. The arm holds meanwhile."""
    if (address := parse_endpoint(endpoint).address) is None or accepts(address):
        return
    log.warning("waiting for the Zenoh router at %s: the arm takes no goals before", endpoint)
    while not accepts(address) and not ending.wait(PAUSE):
        pass


def port_taken(endpoint: str) -> str | None:
    """Returns who has the port of an endpoint, and both ways out; None if the port is free or unknown."""
    if (address := parse_endpoint(endpoint).address) is None or not accepts(address):
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
