"""The claim of a starting daemon among others: at most one serves an arm, and it says who bars the next.

The others have tokens and answers at given times. The claim sees them through a session of its own clock.
"""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from random import Random
from types import SimpleNamespace
from typing import Any

from hyperbit.controller.gateway import daemon as claim_module
from hyperbit.controller.gateway.daemon import AlreadyRunning, Claim
from tests.simulation.verdict import require
from tests.simulation.whole.zenoh_model import Bytes, matches

GRACE, PATIENCE = 0.5, 12.0  # [s] after the claim until the last look; for which a silent token bars
POLLED = 1.5  # [s] between two looks, with the time-out of a query
ARM = "simulated"


@dataclass
class Other:
    """Another daemon of the arm.

    Attributes:
        zid: id of its session; "alive": a daemon of an earlier version, which has no claim.
        since, until: times at which its token exists [s].
        answers: whether it answers.
        serves, simulated: its answer.
    """

    zid: str
    since: float = 0.0
    until: float = 1e9
    answers: bool = True
    serves: bool = True
    simulated: bool = False

    @property
    def token(self) -> str:
        return f"hyperbit/{ARM}/alive" if self.zid == "alive" else f"hyperbit/{ARM}/@claim/{self.zid}"


@dataclass
class Clock:
    """A clock that goes on when somebody sleeps."""

    now: float = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        require(seconds >= 0.0, f"a claim sleeps for {seconds} s")
        self.now += seconds


@dataclass(eq=False)
class Session:
    """The session of a claim: tokens and answers of the others, and those of other real claims.

    Attributes:
        declared: keys that this session has declared, with their handlers.
        peers: sessions of other real claims.
    """

    own: str
    clock: Clock
    others: list[Other]
    declared: dict[str, list[Callable[[Any], None] | None]] = field(default_factory=dict)
    peers: list[Session] = field(default_factory=list)

    def zid(self) -> str:
        return self.own

    def liveliness(self) -> SimpleNamespace:
        return SimpleNamespace(declare_token=lambda key: self._declare(key, None), get=self._tokens)

    def declare_queryable(self, key: str, handler: Callable[[Any], None]) -> SimpleNamespace:
        return self._declare(key, handler)

    def _declare(self, key: str, handler: Callable[[Any], None] | None) -> SimpleNamespace:
        self.declared.setdefault(key, []).append(handler)
        return SimpleNamespace(undeclare=lambda: self.declared[key].remove(handler))

    def _tokens(self, expression: str, timeout: float) -> list[SimpleNamespace]:
        now, found = self.clock.now, list[str]()
        found += [other.token for other in self.others if other.since <= now < other.until]
        for session in (self, *self.peers):
            found += [key for key, handlers in session.declared.items() if None in handlers]
        self.clock.now += 0.01
        return [SimpleNamespace(ok=SimpleNamespace(key_expr=key)) for key in found if matches(expression, key)]

    def get(self, key: str, target: object, timeout: float) -> list[SimpleNamespace]:
        """Queries a key; a silent one takes the whole time-out."""
        replies = list[bytes]()
        for other in self.others:
            if other.answers and other.since <= self.clock.now < other.until:
                who = {"host": f"host-{other.zid}", "pid": 77, "serves": other.serves, "simulated": other.simulated}
                if other.zid == "alive" and key.endswith("/arm"):
                    replies.append(b'{"name": "simulated"}')
                elif other.token == key:
                    replies.append(json.dumps(who).encode())
        for session in self.peers:
            for handler in session.declared.get(key, []):
                if handler is not None:
                    handler(Asked(key, replies))
        self.clock.now += 0.01 if replies else timeout
        return [SimpleNamespace(ok=SimpleNamespace(payload=Bytes(data))) for data in replies]


@dataclass
class Asked:
    key_expr: str
    replies: list[bytes]

    def __enter__(self) -> Asked:
        return self

    def __exit__(self, *error: object) -> None:
        """The query ends."""

    def reply(self, key: str, data: bytes) -> None:
        self.replies.append(data)


@contextmanager
def timed(clock: Clock) -> Iterator[None]:
    before, claim_module.time = claim_module.time, clock  # type: ignore[assignment]
    try:
        yield
    finally:
        claim_module.time = before


def check_claims(random: Random) -> None:
    """Lets a daemon claim the arm among others, and judges what comes of it."""
    clock = Clock(random.uniform(0.0, 100.0))
    with timed(clock):
        if random.random() < 0.3:
            _two_start(clock, random)
        else:
            _one_starts(clock, random)


def _one_starts(clock: Clock, random: Random) -> None:
    began, kind = clock.now, random.choice(("nobody", "serves", "dead", "early", "late", "starts", "old"))
    other = Other(random.choice("0f") + "9")
    match kind:
        case "nobody":
            other.since = 1e9
        case "serves":
            other.since, other.simulated = began - random.choice([-0.3, 5.0]), random.random() < 0.5
        case "dead":
            other.answers, other.until = False, began + random.choice([0.2, 3.0, 8.0, 1e6])
        case "early" | "late":
            other.zid, other.serves = "09" if kind == "early" else "f9", False
        case "starts":
            other.since = began + random.uniform(0.0, 0.4)
        case "old":
            other.zid = "alive"
    session = Session("88", clock, [other])
    claim = Claim(session, ARM)  # type: ignore[arg-type]
    barred = ""
    try:
        claim.confirm()
    except AlreadyRunning as error:
        barred = str(error)
    waited, text = clock.now - began, f"a claim among {other}: {barred or 'serves'}"
    silent = kind == "dead" and other.until > began + PATIENCE
    wanted = kind in ("serves", "early", "starts", "old") or silent
    require(bool(barred) == wanted, text)
    require(waited >= GRACE, f"{text}, after {waited:g} s")
    if kind == "dead":
        gone = min(other.until - began, PATIENCE)
        require(gone <= waited <= max(gone, GRACE) + POLLED, f"{text}, after {waited:g} s")
        require(not barred or other.token in barred, f"{text}; it does not name the token")
    else:
        require(waited <= GRACE + 0.1, f"{text}, after {waited:g} s")
        names = "a host that it does not name" if kind == "old" else f"process 77 on host-{other.zid}"
        boards = ", with simulated boards." if other.simulated else "."
        require(not barred or f"{names}{boards}" in barred, f"{text}; it does not name {names}{boards}")
    _judge_answer(session, serves=not barred)
    claim.close()
    require(not any(session.declared.values()), f"a claim that was given up leaves {session.declared}")


def _two_start(clock: Clock, random: Random) -> None:
    """Two daemons start together: one serves."""
    names = ["11", "22"]
    random.shuffle(names)
    sessions = [Session(name, clock, []) for name in names]
    sessions[0].peers, sessions[1].peers = [sessions[1]], [sessions[0]]
    simulated = [random.random() < 0.5 for _ in names]
    claims = [Claim(s, ARM, simulated=sim) for s, sim in zip(sessions, simulated, strict=True)]  # type: ignore[arg-type]
    serve = list[str]()
    for claim, session in zip(claims, sessions, strict=True):
        _judge_answer(session, serves=False)
        try:
            claim.confirm()
            serve.append(session.own)
        except AlreadyRunning:
            claim.close()
    require(len(serve) == 1, f"of two daemons that start together, {serve} serve")


def _judge_answer(session: Session, *, serves: bool) -> None:
    key = f"hyperbit/{ARM}/@claim/{session.own}"
    replies = list[bytes]()
    for handler in session.declared.get(key, []):
        if handler is not None:
            handler(Asked(key, replies))
    require(len(replies) == 1, f"a claim answers {replies}")
    told = json.loads(replies[0])
    wanted = {"host": socket.gethostname(), "pid": os.getpid(), "serves": serves}
    require({name: told[name] for name in wanted} == wanted, f"a claim answers {told}, not {wanted}")
