"""Mailboxes of set-points and measured tips: the latest sample of each sender comes once, soon, and in order."""

from __future__ import annotations

from dataclasses import dataclass

from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Request
from tests.simulation.judge.verdict import require

MOST_SENDERS, MOST_SENDER = 16, 64  # that wait at once; bytes of an attachment that tell a sender
READ_WITHIN = 0.045  # [s], awake


@dataclass
class Waiting:
    """The latest sample of a sender.

    Attributes:
        first: number of the first sample that it has displaced, or its own.
        awake: awake time of the arrival of that [s].
        at: time of the latest arrival [s].
    """

    payload: bytes
    first: int
    awake: float
    at: float


class Mailboxes:
    """Judges the mailboxes of one key.

    Args:
        key: "setpoint" or "measured_tip".
    """

    def __init__(self, account: InterfaceAccount, key: str) -> None:
        self._a, self._key = account, key
        self.begin()

    def begin(self) -> None:
        self._waiting: dict[str, Waiting] = {}
        self._last = 0  # number of the last sample that the core took

    def arrives(self, request: Request) -> None:
        if "*" in request.name:
            return
        sender = request.attachment[:MOST_SENDER].decode("ascii", "backslashreplace")
        before = self._waiting.get(sender)
        if before is None and len(self._waiting) >= MOST_SENDERS:
            del self._waiting[next(iter(self._waiting))]
        first, awake = (request.number, self._a.awake) if before is None else (before.first, before.awake)
        self._waiting[sender] = Waiting(request.payload, first, awake, self._a.now)

    def taken(self, payload: bytes, sender: str, at: float) -> int:
        """The planner's core takes a sample that has arrived at a time [s].

        Returns:
            number of the first sample that it has displaced, or its own.
        """
        a, waiting = self._a, self._waiting.pop(sender, None)
        text = f"{self._key} of {sender!r}, {payload.decode(errors='replace')[:80]}"
        require(waiting is not None, f"{text} did not come, or came before")
        assert waiting is not None
        require(waiting.payload == payload, f"{text} is not the latest one")
        require(abs(waiting.at - at) < 1e-9 or a.had("still", a.now - 10.0), f"{text} came at {waiting.at}, not {at}")
        return waiting.first

    def tick(self) -> None:
        """Finds samples that nobody reads."""
        a = self._a
        if not a.process or a.slow or a.quits or a.lately("still", 0.2) or a.lately("slow", 0.5):
            return
        for sender, waiting in self._waiting.items():
            late = a.awake - waiting.awake
            require(late <= READ_WITHIN, f"{self._key} of {sender!r} waits for {late:g} s")
