"""A router, and sessions of the wire on it."""

import json
import socket
from collections.abc import Callable, Iterator

import pytest
import zenoh

from hyperbit.controller.ros2.wire.session import Session


class Router:
    """A Zenoh session in mode router, in place of rmw_zenohd, which can be stopped and started again."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        self.start()

    def start(self) -> None:
        settings = {
            "mode": "router",
            "listen": {"endpoints": [self.endpoint]},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "timestamping": {"enabled": True},
        }
        self.session = zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))

    def stop(self) -> None:
        self.session.close()


@pytest.fixture
def router() -> Iterator[Router]:
    router = Router()
    yield router
    router.stop()


@pytest.fixture
def connect(router: Router) -> Iterator[Callable[[], Session]]:
    opened: list[Session] = []

    def connect() -> Session:
        opened.append(Session(router.endpoint, timeout=60.0))
        return opened[-1]

    yield connect
    for session in opened:
        session.close()
