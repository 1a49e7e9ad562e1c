"""Sends answers, feedback and results: any thread puts them in, one thread sends them."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

import zenoh

from controller.gateway.encoding import JSON, encode
from controller.gateway.session import LEASE
from controller.motion import codes
from controller.planning.core.messages import Payload, Reply, refused

log = logging.getLogger(__name__)

MOST_WAITING = 1_000  # messages in each lane
POLL = 0.2  # [s] between two readings of the clock
RECONNECTED = 5.0  # [s] after a standstill, or after the start; clients reconnect at least every 4 s
COMMANDS = ("goal", "jog", "cancel", "stop", "reset", "degrade", "obstacles")

Item = tuple[zenoh.Query | str, str, Payload]


class Outbox:
    """A thread for the Zenoh calls that may wait for a slow peer.

    Messages wait in two lanes. The first has results, feedback and answers to accepted commands, in order. The second
    has refusals and other answers, so that a flood of bad requests delays no result. Results of accepted goals are
    never dropped here. Other messages are dropped while MOST_WAITING are in their lane, because requests could
    otherwise fill the memory. A peer without an answer sees its request end.

    A process that stood still for about its session's lease loses its peers as soon as it continues. Results published
    at that moment would reach no client. Results, and the messages after them in their lane, therefore wait until
    clients have had time to reconnect. The results of an earlier planner process wait in the same way after the start.

    Args:
        session: open session.
        prefix: of all keys, "hyperbit/<arm>".
        lease: of the session [s].
        clock: a clock that continues while the process stands still [s].
    """

    def __init__(
        self,
        session: zenoh.Session,
        prefix: str,
        lease: float = LEASE,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._prefix, self._lease, self._clock = prefix, lease, clock
        self._last_reading, self._wait_until = clock(), -float("inf")  # last clock reading, end of a wait [s]
        self._first, self._second, self._inherited = deque[Item](), deque[Item](), deque[Item]()
        self._reached_from = clock() + RECONNECTED  # time at which clients have reconnected [s]
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

        "inherited" is for the result of a goal of an earlier planner process.
        """
        if key == "inherited":
            self._put(self._inherited, ("result", "result", payload), needed=True)
            return
        refusal = key == "result" and payload["status"] == "refused"
        lane = self._second if refusal or key == "@request" else self._first
        self._put(lane, (key, key, payload), needed=key == "result" and not refusal)

    def has_subscriber(self, key: str) -> bool:
        """Returns whether a peer subscribes to a key."""
        return bool(self._publishers[key].matching_status.matching)  # type: ignore[attr-defined]  # a struct, not bool

    def answer(self, query: zenoh.Query, key: str) -> Reply:
        """Returns a function that answers a query on `key` and ends it."""

        def reply(payload: Payload) -> None:
            carried_out = key in COMMANDS and payload.get("accepted") is True
            self._put(self._first if carried_out else self._second, (query, key, payload), needed=False)

        return reply

    def close(self, timeout: float = 2.0) -> None:
        """Sends the rest, for at most `timeout` seconds."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(timeout)

    def waiting(self) -> int:
        """Returns the number of messages that wait."""
        return len(self._first) + len(self._second) + len(self._inherited)

    def _put(self, lane: deque[Item], item: Item, *, needed: bool) -> None:
        with self._news:
            full = len(lane) >= MOST_WAITING
            if full and not self._full:
                log.warning("peers do not read their answers: answers are dropped")
            self._full = full
            if needed or not full:
                lane.append(item)
                self._news.notify()

    def _next(self) -> Item | None:
        """Returns the next message, the first lane's before the second's; None at the end."""
        with self._news:
            while True:
                waits = self._must_wait() and not self._closing
                lane = self._second if waits else self._first or self._second
                if self._closing or self._clock() >= self._reached_from:
                    lane = self._inherited or lane
                if lane or self._closing:
                    return lane.popleft() if lane else None
                self._news.wait(POLL)

    def _must_wait(self) -> bool:
        """Returns whether a result is next and must wait for clients to reconnect after a standstill."""
        now = self._clock()
        if now - self._last_reading > self._lease / 2:  # keep-alives are sent four times in a lease
            self._wait_until = now + RECONNECTED
            standstill = now - self._last_reading
            log.warning("the process stood still for %.1f s: results wait for %g s", standstill, RECONNECTED)
        self._last_reading = now
        return now < self._wait_until and bool(self._first) and self._first[0][1] == "result"

    def _run(self) -> None:
        while (item := self._next()) is not None:
            target, key, payload = item
            try:
                data = encode(payload)
            except Exception:
                log.exception("a payload cannot be encoded as JSON: %r", payload)
                data = encode(without_json(payload))
            try:
                if isinstance(target, str):
                    self._publishers[target].put(data)
                else:
                    with target:
                        target.reply(f"{self._prefix}/{key}", data, encoding=JSON)
            except Exception as error:  # an error of one peer must not stop the service of the others
                log.warning("not sent on %s: %s", key, error)
            self._last_reading = self._clock()  # waiting for a slow peer is no standstill


def without_json(payload: Payload) -> Payload:
    """Returns a replacement for a payload that cannot be encoded; it has the goal and status of a result."""
    fields = {name: value for name in ("id", "status") if isinstance(value := payload.get(name), str)}
    fields = {name: value.encode(errors="backslashreplace").decode() for name, value in fields.items()}
    return {**refused(codes.INVALID_GOAL, "internal error, see the journal"), **fields}
