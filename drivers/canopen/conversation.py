"""Conversations with boards outside the executor: they block until they are over."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

from drivers.canopen.bus import CanBus
from drivers.canopen.cia301 import Frame
from drivers.canopen.events import Event

_POLL = 0.001  # [s] between two looks at the buses


class Conversation(Protocol):
    """Frames in, frames out; pure like the master."""

    @property
    def over(self) -> bool:
        """Whether nothing more is to be asked or awaited."""

    def start(self, now: float) -> None:
        """Begins; all buses are open."""

    def take(self, event: Event, now: float) -> None:
        """Takes an event of a bus."""

    def send_failed(self, bus: str, frame: Frame, now: float) -> None:
        """Notes that a frame was not sent."""

    def tick(self, now: float) -> None:
        """Does what time brings."""


def converse(it: Conversation, outbox: list[tuple[str, Frame]], buses: Sequence[CanBus]) -> None:
    """Leads a conversation on some buses until it is over.

    Args:
        it: the conversation.
        outbox: into which it puts its frames, with the names of their buses.
        buses: closed; they are opened, and closed again.

    Raises:
        BusError: a bus cannot be opened.
    """
    by_name = {bus.name: bus for bus in buses}

    def flush(now: float) -> None:
        while outbox:
            bus, frame = outbox.pop(0)
            if by_name[bus].send(frame) is not None:
                it.send_failed(bus, frame, now)

    try:
        for bus in buses:
            bus.open()
        begun = time.monotonic()
        it.start(begun)
        flush(begun)
        while not it.over:
            now = time.monotonic()
            for bus in buses:
                for event in bus.poll():
                    it.take(event, now)
                    flush(now)
            it.tick(now)
            flush(now)
            time.sleep(_POLL)
    finally:
        for bus in buses:
            bus.close()
