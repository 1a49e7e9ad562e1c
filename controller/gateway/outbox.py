"""Answers, feedback and results on their way out: any thread hands them over, one thread sends them."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

import zenoh

from controller.gateway.encoding import JSON, encode
from controller.gateway.session import LEASE
from controller.motion import codes
from controller.planning.messages import Payload, Reply, refused

log = logging.getLogger(__name__)

MOST_WAITING = 1_000  # messages in each lane
TURN = 0.2  # [s] between two looks at the clock
RECONNECTED = 5.0  # [s] after a standstill, and after the start; clients try to connect anew every 4 s at least
COMMANDS = ("goal", "jog", "cancel", "stop", "reset", "degrade", "obstacles")

Item = tuple[zenoh.Query | str, str, Payload]


class Outbox:
    """A thread that makes the Zenoh calls which may wait for a slow peer.

    Messages wait in two lanes. The first has results, feedback and the answers to commands that were carried out, in
    order. The second has refusals and other answers; a flood of bad requests therefore delays no result. Results of
    accepted goals are never dropped here. Other messages are dropped while MOST_WAITING are in their lane: requests
    could else fill the memory, and a peer without an answer sees its request end.

    A process that stood still for about the lease of its session loses its peers the moment that it goes on. What it
    published then would reach nobody, so results, and what follows them in their lane, wait until peers have had time
    to connect anew. So do the results of goals of the planner before this one, after the start.

    Args:
        session: open session.
        prefix: of all keys, "hyperbit/<arm>".
        lease: of the session [s].
        clock: time that goes on while the process stands still [s].
    """

    def __init__(
        self,
        session: zenoh.Session,
        prefix: str,
        lease: float = LEASE,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._prefix, self._lease, self._clock = prefix, lease, clock
        self._turned, self._held_until = clock(), -float("inf")  # last look at the clock, and end of a wait [s]
        self._first, self._second, self._inherited = deque[Item](), deque[Item](), deque[Item]()
        self._reached_from = clock() + RECONNECTED  # clients of the planner before have connected [s]
        self._news = threading.Condition()
        self._full = self._closing = False
        self._publishers = {
            "result": session.declare_publisher(
                f"{prefix}/result", encoding=JSON, congestion_control=zenoh.CongestionControl.BLOCK
            ),
            "feedback": session.declare_publisher(
                f"{prefix}/feedback", encoding=JSON, congestion_control=zenoh.CongestionControl.DROP
            ),
            "@request": session.declare_publisher(
                f"{prefix}/@request", encoding=JSON, congestion_control=zenoh.CongestionControl.DROP
            ),
        }
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)
        self._thread.start()

    def publish(self, key: str, payload: Payload) -> None:
        """Publishes on `key`: "result", "feedback", "@request", or "inherited".

        The last is for the result of a goal of the planner before.
        """
        if key == "inherited":
            self._put(self._inherited, ("result", "result", payload), needed=True)
            return
        refusal = key == "result" and payload["status"] == "refused"
        lane = self._second if refusal or key == "@request" else self._first
        self._put(lane, (key, key, payload), needed=key == "result" and not refusal)

    def heard(self, key: str) -> bool:
        """Returns whether somebody subscribes to a key that this publishes on."""
        return bool(self._publishers[key].matching_status.matching)  # type: ignore[attr-defined]  # a struct, not bool

    def answer(self, query: zenoh.Query, key: str) -> Reply:
        """Returns the function that answers a query on `key` and ends it."""

        def reply(payload: Payload) -> None:
            carried_out = key in COMMANDS and payload.get("accepted") is True
            self._put(self._first if carried_out else self._second, (query, key, payload), needed=False)

        return reply

    def close(self, timeout: float = 2.0) -> None:
        """Sends what is left, for `timeout` seconds at most."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(timeout)

    def waiting(self) -> int:
        """Returns how many messages are still to be sent."""
        return len(self._first) + len(self._second) + len(self._inherited)

    def _put(self, lane: deque[Item], item: Item, *, needed: bool) -> None:
        with self._news:
            full = len(lane) >= MOST_WAITING
            if full and not self._full:
                log.warning("peers do not take what is sent: answers are dropped")
            self._full = full
            if needed or not full:
                lane.append(item)
                self._news.notify()

    def _next(self) -> Item | None:
        """Returns the next message, the first lane's before the second's; None at the end."""
        with self._news:
            while True:
                held = self._held() and not self._closing
                lane = self._second if held else self._first or self._second
                if self._closing or self._clock() >= self._reached_from:
                    lane = self._inherited or lane
                if lane or self._closing:
                    return lane.popleft() if lane else None
                self._news.wait(TURN)

    def _held(self) -> bool:
        """Returns whether a result is next, and the process stood still so shortly ago that nobody would hear it."""
        now = self._clock()
        if now - self._turned > self._lease / 2:  # keep-alives go out four times in a lease
            self._held_until = now + RECONNECTED
            log.warning("the process stood still for %.1f s: results wait for %g s", now - self._turned, RECONNECTED)
        self._turned = now
        return now < self._held_until and bool(self._first) and self._first[0][1] == "result"

    def _run(self) -> None:
        while (item := self._next()) is not None:
            target, key, payload = item
            try:
                data = encode(payload)
            except Exception:
                log.exception("a payload has no JSON: %r", payload)
                data = encode(without_json(payload))
            try:
                if isinstance(target, str):
                    self._publishers[target].put(data)
                else:
                    with target:
                        target.reply(f"{self._prefix}/{key}", data, encoding=JSON)
            except Exception as error:  # a peer that is gone must not end the service of the others
                log.warning("not sent on %s: %s", key, error)
            self._turned = self._clock()  # to wait for a slow peer is no standstill


def without_json(payload: Payload) -> Payload:
    """Returns what is sent in place of a payload that has no JSON: of a result, its goal and status are kept."""
    kept = {name: value for name in ("id", "status") if isinstance(value := payload.get(name), str)}
    kept = {name: value.encode(errors="backslashreplace").decode() for name, value in kept.items()}
    return {**refused(codes.INVALID_GOAL, "internal error, see the journal"), **kept}
