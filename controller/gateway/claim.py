"""The claim of a process to an arm: of all that serve its keys, one is in the network."""

import os
import socket
import time
from typing import Any

import msgspec
import zenoh

from hyperbit.controller.decoding.decoding import Unreadable, convert, decode
from hyperbit.controller.network.session import LEASE

GRACE = 0.5  # [s] for a token to reach all other sessions, also those that were opened a moment ago
CLAIM_TIMEOUT = LEASE + 2.0  # [s] until the tokens of a killed daemon, or of a lost host, disappear
ANSWER = 1.0  # [s] for a daemon to answer where it runs
POLL = 0.1  # [s]


class AlreadyRunning(Exception):
    """Another daemon of this arm is in the network; the text says where."""


class Claimant(msgspec.Struct):  # the owner of a claim, as it answers
    host: str
    pid: int
    serves: bool = True  # False until the daemon has looked for other claims
    simulated: bool = False


class Claim:
    """The claim of this process to an arm: the token "hyperbit/<arm>/@claim/<zid>"; a query on it returns the claimant.

    Zenoh does not notify the owner of a liveliness token when another session declares the same one. So each daemon has
    a token of its own, and looks for the claims of others.

    Of daemons that start together, the one with the lowest id of its session serves. Each looks for the last time when
    its claim has reached the others. So of two daemons, at least one finds the other.
    """

    def __init__(self, session: zenoh.Session, arm: str, *, simulated: bool = False) -> None:
        self._session, self._arm, self._own = session, arm, str(session.zid())
        self._claimant = Claimant(socket.gethostname(), os.getpid(), serves=False, simulated=simulated)
        key = f"hyperbit/{arm}/@claim/{self._own}"
        self._queryable = session.declare_queryable(key, self._answer)  # before the token: others then query it
        self._token = session.liveliness().declare_token(key)
        self._declared_at = time.monotonic()

    def confirm(self, timeout: float = CLAIM_TIMEOUT) -> None:
        """Returns when this process may serve the arm, GRACE after its claim at the earliest.

        A daemon that does not answer may keep its token for `timeout` [s]. Raises AlreadyRunning if another daemon
        serves the arm, or will.
        """
        time.sleep(max(self._declared_at + GRACE - time.monotonic(), 0.0))
        until = time.monotonic() + timeout
        while silent := self._silent_tokens():
            if time.monotonic() > until:
                what = f"another daemon of the arm {self._arm!r} is in the network, and does not say where it runs"
                raise AlreadyRunning(f"{what}. Look for its host, end it, or rename this arm ({', '.join(silent)})")
            time.sleep(POLL)
        self._claimant.serves = True

    def close(self) -> None:
        for declared in (self._token, self._queryable):
            declared.undeclare()  # type: ignore[no-untyped-call]

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, msgspec.json.encode(self._claimant))

    def _silent_tokens(self) -> list[str]:
        """Returns the tokens of daemons that do not answer; raises AlreadyRunning if one serves, or comes first."""
        silent, prefix = [], f"hyperbit/{self._arm}"
        replies = [
            reply
            for key in ("@claim/*", "alive")  # earlier versions have only "alive"
            for reply in self._session.liveliness().get(f"{prefix}/{key}", timeout=ANSWER)
        ]
        for token in [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]:
            if (other := token.rpartition("/")[2]) == self._own:
                continue
            key = f"{prefix}/arm" if other == "alive" else token
            answers = list(self._session.get(key, target=zenoh.QueryTarget.ALL, timeout=ANSWER))
            claimants = [claimant(reply.ok.payload.to_bytes()) for reply in answers if reply.ok is not None]
            for who in claimants:
                if who.serves or other < self._own:
                    boards = ", with simulated boards" if who.simulated else ""
                    what = f"another daemon drives the arm {self._arm!r}: process {who.pid} on {who.host}{boards}"
                    raise AlreadyRunning(f"{what}. End it, or rename this arm")
            if not claimants:
                silent.append(token)
        return silent


def claimant(answer: bytes) -> Claimant:
    try:
        value = decode(answer, dict[str, Any])
        return convert(value.get("daemon", value), Claimant)
    except Unreadable:  # of an earlier version
        return Claimant("a host that it does not name", 0)
