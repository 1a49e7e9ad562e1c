"""A router, and sessions of the wire on it."""

import json
from collections.abc import Callable, Iterator

import pytest
import zenoh

from hyperbit.controller.ros2.wire.session import Session
from tests.endpoints import free_endpoint


class Router:
    """A Zenoh session in mode router, in place of rmw_zenohd, which can be stopped and started again."""

    def __init__(self) -> None:
        self.endpoint = free_endpoint()
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
