"""Runs a conversation with boards for commands outside the executor; blocks until its end."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.events import Event

_POLL = 0.001  # [s] between two polls of the buses


class Conversation(Protocol):
    """Takes events and time, and hands out frames. Like the master, it has no I/O and no clock."""

    @property
    def over(self) -> bool:
        """Whether the conversation has ended."""

    def start(self, now: float) -> None:
        """Begins. All buses are open."""

    def receive_event(self, event: Event, now: float) -> None:
        """Takes an event of a bus."""

    def send_failed(self, bus: str, frame: Frame, now: float) -> None:
        """Records that a frame could not be sent."""

    def tick(self, now: float) -> None:
        """Call every millisecond: handles timeouts."""


def converse(it: Conversation, outbox: list[tuple[str, Frame]], buses: Sequence[CanBus]) -> None:
    """Runs a conversation until its end.

    Args:
        it: the conversation.
        outbox: the frames that the conversation hands out, with the names of their buses.
        buses: its buses, still closed; they are opened here, and closed at the end.

    Raises:
        BusError: a bus cannot be opened.
    """
    by_name = {bus.name: bus for bus in buses}

    def flush(now: float) -> None:
        while outbox:
            bus, frame = outbox.pop(0)
            if by_name[bus].send_frame(frame) is not None:
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
                    it.receive_event(event, now)
                    flush(now)
            it.tick(now)
            flush(now)
            time.sleep(_POLL)
    finally:
        for bus in buses:
            bus.close()
