"""Zenoh sessions (no router, no scouting, explicit endpoints), and the claim of one daemon for each arm."""

import json
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import zenoh

LEASE = 10.0  # [s] of silence after which a peer counts as lost; long, because busy machines stand still for seconds
MOST_BLOCKED = 1.0  # [s] that a message waits for a peer that does not read, before the peer is disconnected
TLS = "transport/link/tls"
TLS_FILES = (
    *("root_ca_certificate", "listen_certificate", "listen_private_key"),
    *("connect_certificate", "connect_private_key"),
)
GRACE = 0.5  # [s] for a token to reach all other sessions, also those that were opened a moment ago
PATIENCE = LEASE + 2.0  # [s] until the tokens of a killed daemon, or of a lost host, disappear
ANSWER = 1.0  # [s] for a daemon to answer where it runs
POLL = 0.1  # [s]


def configuration(mode: str, *, listen: str | None = None, connect: str | None = None) -> zenoh.Config:
    """Returns a configuration with the given endpoints and without scouting.

    Args:
        mode: "peer" for the daemon, "client" for its clients.
        listen: endpoint to accept connections at.
        connect: endpoint to connect to.
    """
    settings: dict[str, object] = {
        "mode": mode,
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "listen": {"endpoints": [listen] if listen else []},
        "connect": {"endpoints": [connect] if connect else []},
        "transport": {
            "link": {
                "tx": {
                    "lease": round(LEASE * 1e3),
                    "queue": {"congestion_control": {"block": {"wait_before_close": round(MOST_BLOCKED * 1e6)}}},
                }
            }
        },
    }
    return zenoh.Config.from_json5(json.dumps(settings))


def from_file(path: Path) -> zenoh.Config:
    """Returns the configuration in a Zenoh file; relative paths of certificates and keys start at the file's folder.

    Raises:
        ValueError: the file is missing or no Zenoh configuration, or a certificate or key cannot be read.
    """
    try:
        config = zenoh.Config.from_file(str(path))
    except zenoh.ZError as error:
        raise ValueError(f"{path}: no Zenoh configuration: {error}") from None
    for name, value in json.loads(config.get_json(TLS)).items():
        if name in TLS_FILES and value is not None:
            file = path.parent / value
            try:
                file.open().close()
            except OSError as error:
                raise ValueError(f"{path}: {name}: {file}: {error.strerror}") from None
            config.insert_json5(f"{TLS}/{name}", json.dumps(str(file.absolute())))
    return config


def lease(config: zenoh.Config) -> float:
    """Returns the lease of a configuration's session [s]."""
    return float(json.loads(config.get_json("transport/link/tx/lease"))) / 1e3


def reachable(session: zenoh.Session, config: zenoh.Config) -> Callable[[], bool]:
    """Returns a function that returns whether a session is connected to one of its endpoints, if it has any."""
    endpoints = json.loads(config.get_json("connect/endpoints"))
    return lambda: not endpoints or bool(session.info.routers_zid() or session.info.peers_zid())


def reason(error: zenoh.ZError) -> str:
    """Returns the message of a Zenoh error, without the places in Zenoh's source."""
    return str(error).split(" at /")[0].strip()


class AlreadyRunning(Exception):
    """Another daemon of this arm is in the network; the text says where."""


class Claimant(msgspec.Struct):
    """The owner of a claim, as it answers; `serves` is false until it has looked for other claims."""

    host: str
    pid: int
    serves: bool = True


class Claim:
    """The claim of this process to an arm: the token "hyperbit/<arm>/@claim/<zid>", and who has it as an answer.

    Two daemons of one arm would both run each goal. Zenoh does not notify the owner of a liveliness token when another
    session declares the same one. So each daemon has a token of its own, and looks for the claims of others.

    Of daemons that start together, the one with the lowest id of its session serves. Each looks for the last time when
    its claim has reached the others. So of two daemons, at least one finds the other.
    """

    def __init__(self, session: zenoh.Session, arm: str) -> None:
        self._session, self._arm, self._own = session, arm, str(session.zid())
        self._claimant = Claimant(socket.gethostname(), os.getpid(), serves=False)
        key = f"hyperbit/{arm}/@claim/{self._own}"
        self._queryable = session.declare_queryable(key, self._answer)  # before the token, which others then ask
        self._token = session.liveliness().declare_token(key)
        self._declared_at = time.monotonic()

    def confirm(self, patience: float = PATIENCE) -> None:
        """Returns when this process may serve the arm, GRACE after its claim at the earliest.

        Args:
            patience: how long a daemon that does not answer may keep its token [s].

        Raises:
            AlreadyRunning: another daemon serves the arm, or will.
        """
        time.sleep(max(self._declared_at + GRACE - time.monotonic(), 0.0))
        until = time.monotonic() + patience
        while silent := self._silent_tokens():
            if time.monotonic() > until:
                what = f"another daemon of the arm {self._arm!r} is in the network, and does not say where it runs"
                raise AlreadyRunning(f"{what}. Look for its host, end it, or rename this arm ({', '.join(silent)})")
            time.sleep(POLL)
        self._claimant.serves = True

    def close(self) -> None:
        """Gives up the claim."""
        for declared in (self._token, self._queryable):
            declared.undeclare()  # type: ignore[no-untyped-call]

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, msgspec.json.encode(self._claimant))

    def _silent_tokens(self) -> list[str]:
        """Returns the tokens of other daemons that do not answer. Daemons of earlier versions have only "alive".

        Raises:
            AlreadyRunning: another daemon serves the arm, or its claim comes first.
        """
        silent = []
        for token in [*self._tokens("@claim/*"), *self._tokens("alive")]:
            if (other := token.rpartition("/")[2]) == self._own:
                continue
            claimants = self._claimants(f"hyperbit/{self._arm}/arm" if other == "alive" else token)
            for who in claimants:
                if who.serves or other < self._own:
                    what = f"another daemon drives the arm {self._arm!r}: process {who.pid} on {who.host}"
                    raise AlreadyRunning(f"{what}. End it, or rename this arm")
            if not claimants:
                silent.append(token)
        return silent

    def _tokens(self, key: str) -> list[str]:
        replies = self._session.liveliness().get(f"hyperbit/{self._arm}/{key}", timeout=ANSWER)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def _claimants(self, key: str) -> list[Claimant]:
        replies = self._session.get(key, target=zenoh.QueryTarget.ALL, timeout=ANSWER)
        return [claimant(reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None]


def claimant(answer: bytes) -> Claimant:
    """Returns the claimant in an answer on its claim, or in the payload of `arm`."""
    try:
        value = json.loads(answer)
        return msgspec.convert(value.get("daemon", value), Claimant)
    except (ValueError, AttributeError, msgspec.ValidationError):  # of an earlier version
        return Claimant("a host that it does not name", 0)
