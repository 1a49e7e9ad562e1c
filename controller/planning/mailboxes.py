"""Mailboxes of set-points and measured tips, of which only the latest counts."""

import logging
import math
from collections.abc import Callable, Mapping

from controller.planning.core.events import SetpointArrived, TipArrived

log = logging.getLogger(__name__)

EVERY = 0.02  # [s] between two looks
STREAM_EVERY = 0.005  # [s] the same while set-points come
STREAM_ENDS = 0.5  # [s] after its last set-point

Receive = Callable[[], bytes | None]
Arrived = SetpointArrived | TipArrived


class Mailboxes:
    """The mailboxes, which the loop reads regularly. For the loop's thread, except `set`.

    Attributes:
        due: time of the next look [s].
    """

    def __init__(self) -> None:
        self.due = math.inf
        self._boxes: Mapping[type[Arrived], Receive] = {}
        self._stream_until = -math.inf

    def set(self, kind: type[Arrived], receive: Receive) -> None:
        """Sets the mailbox of a kind: `receive` returns the latest payload, or None, and never waits."""
        self._boxes = {**self._boxes, kind: receive}
        self.due = 0.0

    def look(self, now: float) -> list[Arrived]:
        """Returns what has arrived, and sets `due`."""
        arrived: list[Arrived] = []
        for kind, receive in self._boxes.items():
            try:
                payload = receive()
            except Exception:
                log.exception("a mailbox cannot be read")
                continue
            if payload is not None:
                arrived.append(kind(payload))
            if payload is not None and kind is SetpointArrived:
                self._stream_until = now + STREAM_ENDS
        if self._boxes:
            self.due = now + (STREAM_EVERY if now < self._stream_until else EVERY)
        return arrived
