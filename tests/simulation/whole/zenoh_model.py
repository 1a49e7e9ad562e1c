"""Zenoh on the simulated clock: sessions of the gateway, and clients whose messages arrive in the order of sending."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from random import Random
from typing import Any, NamedTuple, Protocol

from tests.simulation.agenda import Agenda

LATENCY = 0.005  # [s], longest delay from a client to the process
TRANSMITTED = 0.02  # [s] in which a put or reply leaves the process; a kill before loses it
MOST_SAMPLES = 64  # in a ring channel
PROMPT = 0.001  # [s], the same for most of them


class Bytes(NamedTuple):
    data: bytes

    def to_bytes(self) -> bytes:
        return self.data


@dataclass(eq=False)
class Sent:
    """A message of a client.

    Attributes:
        query: whether it is a query; else a put.
        at: time of sending [s].
        replies: takes the payload of each reply.
        drawn: "accepted", or the reasons of the refusals for which it was drawn in calm; empty: nobody can say.
    """

    client: int
    name: str
    payload: bytes
    attachment: bytes
    query: bool
    at: float
    replies: list[bytes] = field(default_factory=list)
    drawn: tuple[str, ...] = ()


class Observer(Protocol):
    """Sees what arrives at the daemon and what leaves it."""

    def arrives(self, sent: Sent, key: str) -> object:
        """A message arrives on a declared key; returns what identifies it to `replies`."""

    def replies(self, request: object, data: bytes) -> None:
        """A reply leaves the process."""

    def publishes(self, key: str, data: bytes) -> None:
        """A publication leaves the process."""

    def ends_in_order(self) -> None:
        """The process ends in order, and all that it sent has left."""


class SimulatedSample:
    """A put, as the gateway sees it."""

    def __init__(self, sent: Sent) -> None:
        self.key_expr, self.payload, self.attachment = sent.name, Bytes(sent.payload), Bytes(sent.attachment)


class SimulatedQuery(SimulatedSample):
    """A query, as the gateway sees it."""

    def __init__(self, sent: Sent, session: SimulatedSession, request: object) -> None:
        super().__init__(sent)
        self._sent, self._session, self._request, self._over = sent, session, request, False

    def reply(self, key: str, data: bytes, encoding: object) -> None:
        assert not self._over, f"a query on {self.key_expr} that has ended is answered"
        self._session.leave(lambda: self._deliver(data))

    def _deliver(self, data: bytes) -> None:
        self._session.network.observer.replies(self._request, data)
        if self._sent.client not in self._session.network.gone:
            self._sent.replies.append(data)

    def __enter__(self) -> SimulatedQuery:
        return self

    def __exit__(self, *error: object) -> None:
        self._over = True


class Declared:
    def __init__(self, session: SimulatedSession, name: str, handle: Callable[[Any], object], query: bool) -> None:
        self.name, self.handle, self.query = name, handle, query
        self._session, self._waiting = session, deque[SimulatedSample](maxlen=MOST_SAMPLES)
        if not callable(handle):  # a ring channel
            self.handle = self._waiting.append
        session.declared.append(self)

    def try_recv(self) -> SimulatedSample | None:
        """Returns the oldest sample that waits in a ring channel."""
        return self._waiting.popleft() if self._waiting else None

    def undeclare(self) -> None:
        self._session.declared.remove(self)


class Publisher:
    def __init__(self, session: SimulatedSession, key: str) -> None:
        self._session, self._key = session, key
        self.matching_status = session.network.matching

    def put(self, data: bytes) -> None:
        observer, key = self._session.network.observer, self._key
        self._session.leave(lambda: observer.publishes(key, data))


class SimulatedSession:
    """The session of one process, with the part of `zenoh.Session` that the gateway uses.

    Attributes:
        open: whether the process lives.
        leaving: what was sent and has not left the process, in order.
    """

    def __init__(self, network: ZenohModel) -> None:
        self.network, self.declared, self.open = network, list[Declared](), True
        self._last, self.leaving = 0.0, deque[Callable[[], None]]()

    def declare_queryable(self, name: str, handler: Any) -> Declared:
        return Declared(self, name, getattr(handler, "callback", handler), query=True)

    def declare_subscriber(self, name: str, handler: Any) -> Declared:
        return Declared(self, name, getattr(handler, "callback", handler), query=False)

    def declare_publisher(self, name: str, **options: object) -> Publisher:
        return Publisher(self, name.rpartition("/")[2])

    def liveliness(self) -> SimulatedSession:
        return self

    def declare_token(self, name: str) -> Declared:
        return Declared(self, name, lambda sample: None, query=False)

    def receive(self, sent: Sent) -> None:
        """Hands a message that arrives to each key that it names."""
        for declared in [d for d in self.declared if d.query == sent.query and matches(sent.name, d.name)]:
            if declared in self.declared:
                request = self.network.observer.arrives(sent, declared.name.rpartition("/")[2])
                it = SimulatedQuery(sent, self, request) if sent.query else SimulatedSample(sent)
                declared.handle(it)

    def leave(self, happen: Callable[[], None]) -> None:
        """Lets something leave the process, after all that was sent before."""
        network = self.network
        longest = TRANSMITTED if network.random.random() < 0.05 else PROMPT
        self._last = max(self._last, network.agenda.now + network.random.uniform(0.0, longest))
        self.leaving.append(happen)
        network.agenda.at(self._last, self._left)

    def _left(self) -> None:
        if self.open:
            self.leaving.popleft()()


class Matching(NamedTuple):
    """Whether somebody subscribes to a key."""

    matching: bool


class ZenohModel:
    """The network between clients and the daemon.

    Attributes:
        awake_at: returns when the process is awake [s].
        gone: clients that have vanished.
        lost: whether the daemon has lost all clients; what these send meanwhile does not arrive.
        matching: whether a recorder listens.
    """

    def __init__(self, agenda: Agenda, random: Random, observer: Observer, awake_at: Callable[[], float]) -> None:
        self.agenda, self.random, self.observer, self.awake_at = agenda, random, observer, awake_at
        self.session: SimulatedSession | None = None
        self.gone: set[int] = set()
        self.lost = False
        self.matching = Matching(random.random() < 0.3)
        self._last: dict[int, float] = {}

    def open(self) -> SimulatedSession:
        self.session = SimulatedSession(self)
        self._last.clear()  # nothing waits for a process that has ended
        return self.session

    def finish(self) -> None:
        """Lets all leave that the session has sent, before it ends in order."""
        assert self.session is not None
        while self.session.leaving:
            self.session.leaving.popleft()()
        self.observer.ends_in_order()

    def close(self) -> None:
        """Ends the session without a word."""
        if self.session is not None:
            self.session.open, self.session = False, None

    def send(self, client: int, name: str, payload: bytes, attachment: bytes = b"", query: bool = True) -> Sent:
        """Sends a message; those of one client arrive in order, those to a process that stands still when it goes on.

        Without a process the message is lost.
        """
        sent = Sent(client, name, payload, attachment, query, self.agenda.now)
        at = max(self._last.get(client, 0.0), self.agenda.now + self.random.uniform(0.0, LATENCY))
        self._last[client] = at
        session = self.session
        self.agenda.at(at, lambda: self._arrive(sent, session))
        return sent

    def _arrive(self, sent: Sent, session: SimulatedSession | None) -> None:
        if session is None or session is not self.session or self.lost:
            return
        awake_at = self.awake_at()
        if self.agenda.now < awake_at:
            self._last[sent.client] = max(self._last[sent.client], awake_at)
            self.agenda.at(awake_at, lambda: self._arrive(sent, session))
        else:
            session.receive(sent)


@lru_cache(1000)
def matches(expression: str, name: str) -> bool:
    if "*" not in expression:
        return expression == name
    pattern = re.escape(expression).replace(r"\*\*/", "(?:.*/)?").replace(r"\*\*", ".*").replace(r"\*", "[^/]*")
    return re.fullmatch(pattern, name) is not None
