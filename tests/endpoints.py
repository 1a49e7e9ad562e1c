"""TCP ports of this computer that nobody listens at."""

import socket


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def free_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"
