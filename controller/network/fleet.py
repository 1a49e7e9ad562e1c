"""The arms of a network, also below namespaces: their liveliness, their states, and their daemons.

A Zenoh namespace prefixes all keys of a session. The arm `left` of a cell with the namespace `cell1` has the keys
`cell1/hyperbit/left/*` for a session without a namespace.
"""

import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import zenoh

from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.state import State

# All arms: of the session's own namespace, and of namespaces below it. No key matches both.
OWN, BELOW = "hyperbit/*", "*/**/hyperbit/*"
PLACES = (OWN, BELOW)

OLD = 1.5  # [s] without a state, after which the state counts as old
MOST_ARMS = 1000  # a further arm takes the place of one that is gone
GONE_KEPT = 600.0  # [s] for which a gone arm is kept
TOKEN_TIMEOUT = 1.0  # [s] for the list of tokens
LIST_TIMEOUT = 10.0  # [s] for the list of tokens, if the caller needs it
DESCRIPTION_TIMEOUT = 2.0  # [s] for an arm's answer on `arm`; then it is asked again
POLL = 0.01  # [s]


class ArmAddress(NamedTuple):
    """The address of an arm; `namespace` is empty for an arm in the namespace of the session."""

    namespace: str
    name: str

    def __str__(self) -> str:
        return f"{self.namespace}/{self.name}" if self.namespace else self.name

    @property
    def prefix(self) -> str:
        return f"{self.namespace}/hyperbit/{self.name}" if self.namespace else f"hyperbit/{self.name}"


class ArmStatus(NamedTuple):
    """The last news of one arm."""

    address: ArmAddress
    gone_at: float | None  # time at which its liveliness token disappeared [UNIX s]; None while it is alive
    state: State | None  # the latest; None if none came, or it is unreadable
    age: float | None  # time since the arrival of the latest state [s]
    host: str | None  # computer of its daemon; None until the daemon has answered
    version: str | None  # of hyperbit there; None until the daemon has answered
    is_new: bool  # state, host or version are missing because the arm has just appeared

    @property
    def is_old(self) -> bool:
        """Whether no state came for OLD seconds."""
        return self.age is None or self.age > OLD


@dataclass
class Presence:
    gone_at: float | None = None  # UNIX [s]
    changed_at: float = 0.0  # time of the last token, or of its end, monotonic [s]
    description: Description | None = None
    asked_at: float = -DESCRIPTION_TIMEOUT  # [s]


class Fleet:
    """Follows all arms by two subscriptions to states and two to tokens, however many arms there are.

    Zenoh's threads only store messages. Another thread calls the methods.

    Args:
        session: without a namespace it finds the arms of all namespaces.
        listed: arms that `alive` found. Call `alive` before this: until a new subscription to tokens has its history,
            Zenoh answers a query for tokens with the part of the history that has come.
    """

    def __init__(self, session: zenoh.Session, listed: Iterable[ArmAddress] = ()) -> None:
        self._session, self._lock = session, threading.Lock()
        self._arms: dict[ArmAddress, Presence] = {}
        self._states: dict[ArmAddress, tuple[bytes, float]] = {}  # with times of arrival [s]
        liveliness = session.liveliness()
        self._declared = [
            *(session.declare_subscriber(f"{place}/state", self._on_state) for place in PLACES),
            *(liveliness.declare_subscriber(f"{place}/alive", self._on_token, history=True) for place in PLACES),
        ]
        for address in listed:
            self._set_alive(address)

    def close(self) -> None:
        while self._declared:
            self._declared.pop().undeclare()  # type: ignore[no-untyped-call]

    def wait_for_states(self, timeout: float, *, described: bool = False) -> list[ArmStatus]:
        """Returns all arms as soon as each known, alive arm has sent its state, or after `timeout` [s].

        If `described`, it also waits for host and version of each arm.
        """
        until = time.monotonic() + timeout
        while True:
            if described:
                self.ask()
            arms = self.arms()
            here = [arm for arm in arms if arm.gone_at is None]
            if (
                not any(arm.age is None or (described and arm.version is None) for arm in here)
                or time.monotonic() > until
            ):
                return arms
            time.sleep(POLL)

    def ask(self) -> None:
        """Requests the description of each alive arm without one, at most once in DESCRIPTION_TIMEOUT."""
        now = time.monotonic()
        with self._lock:
            wanted = [
                (address, arm)
                for address, arm in self._arms.items()
                if arm.gone_at is None and arm.description is None and now - arm.asked_at >= DESCRIPTION_TIMEOUT
            ]
            for _, arm in wanted:
                arm.asked_at = now
        for address, _ in wanted:
            self._session.get(
                f"{address.prefix}/arm",
                self._on_description,
                target=zenoh.QueryTarget.ALL,
                timeout=DESCRIPTION_TIMEOUT,
            )

    def arms(self) -> list[ArmStatus]:
        """Returns all arms in the order of namespaces and names; forgets arms that are gone for GONE_KEPT."""
        now = time.monotonic()
        with self._lock:
            for address in [a for a, arm in self._arms.items() if arm.gone_at and now - arm.changed_at > GONE_KEPT]:
                del self._arms[address]
                self._states.pop(address, None)
            known, states = dict(self._arms), dict(self._states)
        found = []
        for address, arm in sorted(known.items()):
            data, heard = states.get(address, (b"", None))
            about = arm.description or Description()
            age = None if heard is None else max(now - heard, 0.0)
            new = (heard is None or arm.description is None) and now - arm.changed_at < DESCRIPTION_TIMEOUT
            found.append(ArmStatus(address, arm.gone_at, readable(data), age, about.daemon.host, about.version, new))
        return found

    # --- called by Zenoh's threads

    def _on_state(self, sample: zenoh.Sample) -> None:
        if (address := address_of(str(sample.key_expr))) is None:
            return
        with self._lock:
            if address in self._arms or address in self._states or len(self._states) < MOST_ARMS:
                self._states[address] = sample.payload.to_bytes(), time.monotonic()

    def _on_token(self, sample: zenoh.Sample) -> None:
        if (address := address_of(str(sample.key_expr))) is None:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            self._set_alive(address)
            return
        with self._lock:
            if (arm := self._arms.get(address)) is not None:
                arm.gone_at, arm.changed_at = time.time(), time.monotonic()

    def _on_description(self, reply: zenoh.Reply) -> None:
        if reply.ok is None or (address := address_of(str(reply.ok.key_expr))) is None:
            return
        try:
            about = decode(reply.ok.payload.to_bytes(), Description)
        except Unreadable:
            about = Description()  # the arm is not asked again
        with self._lock:
            if (arm := self._arms.get(address)) is not None:
                arm.description = about

    def _set_alive(self, address: ArmAddress) -> None:
        """Records that an arm is alive. An arm that was gone may have another daemon now."""
        with self._lock:
            arm = self._arms.get(address)
            if arm is not None and arm.gone_at is None:
                return
            if arm is None and len(self._arms) >= MOST_ARMS:
                gone = [(it.changed_at, there) for there, it in self._arms.items() if it.gone_at is not None]
                if not gone:
                    return
                longest = min(gone)[1]
                del self._arms[longest]
                self._states.pop(longest, None)
            self._arms[address] = Presence(changed_at=time.monotonic())


def alive(session: zenoh.Session, places: Iterable[str] = PLACES, timeout: float = TOKEN_TIMEOUT) -> list[ArmAddress]:
    """Returns the arms whose liveliness tokens exist, sorted; none if this client may not ask.

    `places` are key expressions of arms, such as "hyperbit/*"; `timeout` is the longest wait for the answer [s].
    """
    asked = [session.liveliness().get(f"{place}/alive", timeout=timeout) for place in places]
    tokens = (reply.ok for replies in asked for reply in replies if reply.ok is not None)
    return sorted({it for token in tokens if (it := address_of(str(token.key_expr))) is not None})


def address_of(key: str) -> ArmAddress | None:
    """Returns the arm of a key such as "cell1/hyperbit/left/state"; None if the key belongs to no arm."""
    parts = key.split("/")
    if len(parts) < 3 or parts[-3] != "hyperbit" or not is_name(parts[-2]):
        return None
    return ArmAddress("/".join(parts[:-3]), parts[-2])


def is_name(text: str) -> bool:
    return 0 < len(text) <= 64 and text.isascii() and text.replace("-", "a").replace("_", "a").isalnum()


def readable(data: bytes) -> State | None:
    """Returns a state; None if it cannot be read."""
    try:
        return decode(data, State)
    except Unreadable:
        return None
