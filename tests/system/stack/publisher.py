"""A Zenoh publisher that streams set-points."""

import itertools
import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import zenoh

from tests.system.stack.observer import Observer
from tests.waiting import SLOWNESS, eventually

START = (0.5, 2.8)
RATE = 50.0 / SLOWNESS  # [Hz]
LONGEST_STEP = 5.0 / RATE  # [s]
ATTEMPTS = 20
FOLLOWING = "following a setpoint"  # a reason in `state`
STOPPED = "the stream of setpoints has stopped"  # a reason in `state`
BAD = [b"{", b'{"position": [NaN, 1]}', b'{"position": [1, 2], "stamp": 1}', b'{"position": [1, 2, 3]}', b" " * 20_000]


def circle(t: float) -> tuple[float, float]:
    """A goal that moves in a circle at 0.1 m/s, slower on a slow machine, from START on."""
    turn = 0.5 * t / SLOWNESS
    return START[0] + 0.2 * math.sin(turn), START[1] + 0.2 * (1 - math.cos(turn))


class Publisher:
    """Streams set-points of a goal that moves with the clock."""

    def __init__(self, session: zenoh.Session, client: Observer, name: str) -> None:
        self._session, self._client, self._key = session, client, f"hyperbit/{name}/setpoint"
        self.way: Callable[[float], tuple[float, float]] = circle
        self.position = START

    def put(self, payload: dict[str, Any] | bytes) -> None:
        self._session.put(self._key, payload if isinstance(payload, bytes) else json.dumps(payload))

    def stream(self, ended: Callable[[float], bool], bad: bool = False) -> None:
        """Streams until `ended(time)` returns true; with `bad` an invalid set-point follows each one.

        The goal does not jump: its time stands still while this machine does.
        """
        t, last, k = 0.0, time.monotonic(), 0
        while not ended(t):
            self.position = self.way(t)
            self.put({"position": self.position, "stamp": time.time()})
            time.sleep(0.5 / RATE)
            if bad:
                self.put(BAD[k % len(BAD)])
            time.sleep(0.5 / RATE)
            now = time.monotonic()
            t, last, k = t + min(now - last, LONGEST_STEP), now, k + 1

    @contextmanager
    def streaming(self) -> Iterator[None]:
        """Streams while the context lasts; then waits until the stream has ended, so that the next one is another."""
        over, began = threading.Event(), time.time()
        thread = threading.Thread(target=self.stream, args=(lambda t: over.is_set(),))
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            self.followed(began)

    def throughout(self, check: Callable[[], None]) -> None:
        """Calls `check` while one stream is followed.

        After a pause of this machine the planner counts the rest of the stream as a new one, and follows it. A check
        that fails for this is called again.
        """
        for attempt in itertools.count():
            with self.streaming():
                self._client.wait_now("executing", FOLLOWING)
                streams = self.status()["streams"]
                try:
                    check()
                    return
                except AssertionError:
                    if self.status()["streams"] == streams or attempt == ATTEMPTS:
                        raise

    def status(self) -> dict[str, Any]:
        status: dict[str, Any] = self._client.diagnosed()["setpoint"]
        return status

    def followed(self, began: float) -> None:
        """Waits until the stream is neither followed nor heard; notes that the arm may have moved until now."""
        before = len(self._client.heard["state"])

        def ended() -> bool:
            states = self._client.heard["state"][before:]
            return any(not state["reason"].startswith("following") for state in states)

        eventually(ended)
        eventually(lambda: self.status()["rate"] == 0)
        self._client.streams.append((began, time.time()))
