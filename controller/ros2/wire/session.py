"""The Zenoh session of ROS 2's network: a client of the router that `ros2 run rmw_zenoh_cpp rmw_zenohd` starts.

The session is a client, because a peer behind the router exchanges no data with rmw_zenoh's sessions until they link.
"""

import itertools
import json
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any, NamedTuple, Self
from uuid import UUID, uuid4

import zenoh
import zenoh.ext

from hyperbit.controller.ros2.wire.tokens import ADMIN_SPACE, BadToken, Token, parse

SECOND = 1_000_000_000  # [ns]
LATEST = 2**31 * SECOND - 1  # [ns since 1970], of the times of ROS 2
ROUTER = "tcp/localhost:7447"
MOST_FRAGMENTS = 10_000_000  # bytes, about: longest message that Zenoh assembles; it drops longer ones
LONGEST_PAUSE = 4.0  # [s] between two attempts to reach the router


class NoRouter(ConnectionError):
    """The router does not answer."""


class Computer(NamedTuple):
    """Clocks, chance and threads of nodes and bridges. A simulation has its own."""

    monotonic: Callable[[], float] = time.monotonic  # [s]
    time_ns: Callable[[], int] = time.time_ns  # [ns since 1970]
    sleep: Callable[[float], None] = time.sleep
    uuid: Callable[[], UUID] = uuid4
    pool: Callable[[int, str], Executor] = ThreadPoolExecutor  # number and name of the threads
    condition: Callable[[], threading.Condition] = threading.Condition

    def time(self) -> float:
        """Returns the UNIX time [s]."""
        return self.time_ns() / 1e9

    def stamp(self) -> int:
        """Returns the UNIX time [ns], at most LATEST: the clock may be set to any year."""
        return min(self.time_ns(), LATEST)


class Session:
    """An open session. After a loss of the router it connects again, and Zenoh repeats all declarations.

    Args:
        router: Zenoh endpoint.
        timeout: longest time to wait for the router [s]. A client of Zenoh cannot begin without a router.

    Raises:
        NoRouter: no router answered in time, or the endpoint has the wrong form.
    """

    def __init__(self, router: str = ROUTER, timeout: float = 10.0) -> None:
        try:
            self.zenoh = zenoh.open(configuration(router, timeout))
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0].strip()
            raise NoRouter(f"no router at {router!r} within {timeout:g} s: {reason}") from None
        self.zid = str(self.zenoh.zid())  # the session's id in tokens
        self.computer = Computer()
        self._numbers = itertools.count()
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.zenoh.close()  # type: ignore[no-untyped-call]

    def next_number(self) -> str:
        """Returns the number of a new node or endpoint of this session."""
        with self._lock:
            return str(next(self._numbers))

    def declare_publisher(self, key: str, **options: Any) -> "zenoh.ext.AdvancedPublisher":
        return zenoh.ext.declare_advanced_publisher(self.zenoh, key, **options)

    def declare_subscriber(
        self, key: str, handler: Callable[[zenoh.Sample], None], **options: Any
    ) -> "zenoh.ext.AdvancedSubscriber[None]":
        return zenoh.ext.declare_advanced_subscriber(self.zenoh, key, handler, **options)

    def connected(self) -> bool:
        """Returns whether the session has a connection to the router."""
        return bool(self.zenoh.info.routers_zid())

    def tokens(self, domain: int = 0, timeout: float = 2.0) -> list[Token]:
        """Returns the tokens of all nodes and endpoints in a domain, known within `timeout` [s]; ignores other keys."""
        found: dict[Token, None] = {}  # the session's own tokens come twice
        for reply in self.zenoh.liveliness().get(f"{ADMIN_SPACE}/{domain}/**", timeout=timeout):
            if reply.ok is not None:
                try:
                    found[parse(str(reply.ok.key_expr))] = None
                except BadToken:
                    continue
        return list(found)


def configuration(router: str, timeout: float) -> zenoh.Config:
    """Returns the configuration of a client, with the timestamps that publishers' caches need."""
    settings: dict[str, object] = {
        "mode": "client",
        "connect": {
            "endpoints": [router],
            "timeout_ms": round(timeout * 1e3),
            "retry": {"period_init_ms": 500, "period_max_ms": round(LONGEST_PAUSE * 1e3), "period_increase_factor": 2},
        },
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "timestamping": {"enabled": True},
        "transport": {"shared_memory": {"enabled": False}, "link": {"rx": {"max_message_size": MOST_FRAGMENTS}}},
    }
    return zenoh.Config.from_json5(json.dumps(settings))
