"""TCP ports of this computer that nobody listens at."""

import contextlib
import random
import socket

PORTS = range(10_000, 32_000)  # below those that Linux gives to outgoing connections, which could take one meanwhile


def free_port() -> int:
    drawn = random.SystemRandom()  # others draw, too: no seed may give the same ports to two processes
    while True:
        port = drawn.choice(PORTS)
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def free_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"
