"""Sends answers, feedback, results and states: any thread queues them, one thread sends them."""

import contextlib
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Literal

import msgspec
import numpy as np
import zenoh
from msgspec import Struct
from msgspec.structs import replace

from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.goals import Answer, Feedback, GoalEnd, Note, Result, internal_error
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.network.session import LEASE
from hyperbit.controller.planning.core.events import Identity, Published, PublishResult

log = logging.getLogger(__name__)

MOST_WAITING = 1_000  # messages in each lane
POLL = 0.2  # [s] between two readings of the clock
SENT_WITHIN = 0.05  # [s], assumed time until a put has left the process; nearly all leave within 3 ms
RECONNECTED = 5.0  # [s] after a standstill, or after the start; clients reconnect at least every 4 s
COMMANDS = ("goal", "jog", "cancel", "stop", "reset", "degrade", "obstacles", "fault")
PUBLISHED = {"result": zenoh.CongestionControl.BLOCK} | dict.fromkeys(
    ("feedback", "state", "diagnostics", "@request"), zenoh.CongestionControl.DROP
)
LATEST = ("state", "diagnostics")  # only the latest waits
JSON = zenoh.Encoding.APPLICATION_JSON

# A message: a query's reply, or None to publish; then its key and content.
Item = tuple[zenoh.Query | PublishResult | None, str, Struct]


class Outbox:
    """A thread for the Zenoh calls that may wait for a slow peer. No method waits, except `close`.

    Messages wait in two lanes. The first has results, feedback and answers to accepted commands, in order. The second
    has refusals and other answers, so that a flood of bad requests delays no result. Results of accepted goals are
    never dropped here. Other messages are dropped while MOST_WAITING are in their lane, because requests could
    otherwise fill the memory. A peer without an answer sees its request end. Between the lanes come the latest `state`
    and `diagnostics`; a slow peer misses some of them.

    A process that stood still for about its session's lease loses its peers as soon as it continues. Results published
    at that moment would reach no client. Results, and the messages after them in their lane, therefore wait until
    clients have had time to reconnect. The results of an earlier planner process wait in the same way after the start.

    `fatal` takes a message when the thread dies. `clock` continues while the process stands still.
    """

    def __init__(
        self,
        session: zenoh.Session,
        prefix: str,  # of all keys, "hyperbit/<arm>"
        ended: Callable[[str | None], None],  # takes the id of a goal, before its result is published
        mark: Callable[[Identity, Result], None],  # marks a result durably, before its put
        post: Callable[[Published], None],
        fatal: Callable[[str], None],
        lease: float = LEASE,  # of the session [s]
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._prefix, self._lease, self._clock = prefix, lease, clock
        self._ended, self._mark, self._post, self._fatal = ended, mark, post, fatal
        self.last_reading, self.wait_until = clock(), -float("inf")  # last clock reading, end of a wait [s]
        self._reached_from = clock() + RECONNECTED  # time at which clients have reconnected [s]
        # Any thread appends, only the thread of the outbox takes. Both are atomic.
        self._first, self._second, self._inherited = deque[Item](), deque[Item](), deque[Item]()
        self._latest = dict[str, Struct]()
        self._put_results = deque[tuple[float, int]]()  # departure [s] and number of each result
        self._wake: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._full = self._closing = False
        self._poses = 0  # number of changes
        self.publishers = {
            key: session.declare_publisher(f"{prefix}/{key}", encoding=JSON, congestion_control=control)
            for key, control in PUBLISHED.items()
        }
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)

    def start(self) -> None:  # without the thread, the caller sends queued messages by `step`
        self._thread.start()

    def publish(
        self,
        key: Literal["state", "diagnostics", "feedback", "result", "@request"],
        message: State | Diagnostics | Feedback | GoalEnd | Note,
    ) -> None:
        """Publishes on a key. A `state` or `diagnostics` replaces the one that waits; a `result` is a put's refusal."""
        if key in LATEST:
            self._latest[key] = replace(message, poses=self._poses) if isinstance(message, State) else message
            self._wake_up()
        else:
            self._put(self._first if key == "feedback" else self._second, (None, key, message))

    def count_poses_change(self) -> None:  # a new number in `state` makes clients read the poses
        self._poses += 1

    def publish_result(self, result: PublishResult) -> None:
        """Marks the result of an accepted goal, publishes it, and posts `Published` when it has left the process.

        If the process is killed in between, clients may have the result or not. Therefore the next process publishes
        it again, with the field `repeated`.
        """
        self._ended(result.result.id)
        lane = self._inherited if result.inherited else self._first
        self._put(lane, (result, "result", result.result), needed=True)

    def recorded(self) -> bool:
        try:
            return bool(self.publishers["@request"].matching_status.matching)  # type: ignore[attr-defined]  # no bool
        except zenoh.ZError:  # the session is closed
            return False

    def answer(self, query: zenoh.Query, key: str, answer: Answer | Description) -> None:
        carried_out = key in COMMANDS and isinstance(answer, Answer) and answer.accepted
        self._put(self._first if carried_out else self._second, (query, key, answer))

    def waiting(self) -> int:
        return len(self._first) + len(self._second) + len(self._inherited)

    def close(self, timeout: float = 2.0) -> None:
        self._closing = True
        self._wake_up()
        if self._thread.ident is not None:
            self._thread.join(timeout)

    def _put(self, lane: deque[Item], item: Item, *, needed: bool = False) -> None:
        full = len(lane) >= MOST_WAITING
        if full and not self._full:
            log.warning("peers do not read their answers: answers are dropped")
        self._full = full
        if needed or not full:
            lane.append(item)
            self._wake_up()

    def _wake_up(self) -> None:
        """Makes the thread look at the lanes. One waiting call is enough: the thread looks afterwards."""
        if self._wake.empty():
            self._wake.put(None)

    # --- the thread

    def _run(self) -> None:
        try:
            while (wait := self.step()) is not None:
                if wait > 0.0:
                    with contextlib.suppress(queue.Empty):
                        self._wake.get(timeout=wait)
        except BaseException as error:
            log.exception("the outbox failed")
            self._fatal(f"the thread that publishes results failed: {type(error).__name__}: {error}")

    def step(self) -> float | None:
        """Sends one message, if one may be sent; returns how long to wait for the next one [s], None at the end."""
        self._post_published(self._clock())
        item = self._next()
        if item is not None:
            self._send(*item)
            self.last_reading = self._clock()  # a wait for a slow peer is no standstill
            return 0.0
        if self._closing:
            self._post_published(np.inf)
            return None
        return max(min(self._put_results[0][0] - self._clock(), POLL), 0.0) if self._put_results else POLL

    def _next(self) -> Item | None:
        results_wait = self._stood_still() and not self._closing
        inherited_wait = results_wait or (self._clock() < self._reached_from and not self._closing)
        if self._inherited and not inherited_wait:
            return self._inherited.popleft()
        if self._first and not (results_wait and self._first[0][1] == "result"):
            return self._first.popleft()
        for key in LATEST:
            if (latest := self._latest.pop(key, None)) is not None:
                return None, key, latest
        return self._second.popleft() if self._second else None

    def _post_published(self, now: float) -> None:
        while self._put_results and self._put_results[0][0] <= now:
            self._post(Published(self._put_results.popleft()[1]))

    def _stood_still(self) -> bool:
        now = self._clock()
        if now - self.last_reading > self._lease / 2:  # keep-alives are sent four times in a lease
            self.wait_until = now + RECONNECTED
            standstill = now - self.last_reading
            log.warning("the process stood still for %.1f s: results wait for %g s", standstill, RECONNECTED)
        self.last_reading = now
        return now < self.wait_until

    def _send(self, target: zenoh.Query | PublishResult | None, key: str, message: Struct) -> None:
        if isinstance(message, Diagnostics):
            message = replace(message, queues={**message.queues, "outbox": self.waiting()})
        data = encoded(message)
        if isinstance(target, PublishResult):
            self._mark(target.identity, target.result)
        try:
            if target is None or isinstance(target, PublishResult):
                self.publishers[key].put(data)
            else:
                with target:
                    target.reply(f"{self._prefix}/{key}", data, encoding=JSON)
        except Exception as error:  # an error of one peer must not stop the service of the others
            log.warning("not sent on %s: %s", key, error)  # the executor keeps a result, for the next planner
            return
        if isinstance(target, PublishResult):
            self._put_results.append((self._clock() + SENT_WITHIN, target.number))


def encoded(message: Struct) -> bytes:
    """Returns a message as JSON; non-finite numbers become null. Of an unencodable message: id and status."""
    try:
        return msgspec.json.encode(message, enc_hook=plain)
    except Exception:
        log.exception("a message cannot be encoded as JSON: %r", message)
        names = {name: value for name in ("id", "status") if isinstance(value := getattr(message, name, None), str)}
        names = {name: value.encode(errors="backslashreplace").decode() for name, value in names.items()}
        return msgspec.json.encode({**msgspec.to_builtins(internal_error()), **names})


def plain(value: object) -> Any:
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be encoded as JSON")
