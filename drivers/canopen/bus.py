"""One CAN bus over python-can, without blocking: the only module here with I/O."""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.canopen.cia301 import Frame
from drivers.canopen.events import Event
from drivers.canopen.wiring import BusSettings


class CanBus:
    """One CAN bus. No method blocks, and only `open` raises.

    A bus that goes down is opened again by `poll`, with a growing pause between attempts.

    Args:
        settings: which bus.
        clock: for the pauses [s].
    """

    def __init__(self, settings: BusSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self.settings = settings

    @property
    def name(self) -> str:
        """Of the bus."""
        return self.settings.name

    def open(self) -> None:
        """Opens the bus.

        Raises:
            BusError: the interface cannot be opened.
        """

    def fileno(self) -> int | None:
        """Returns the file descriptor to wait on; None if there is none now: call `poll` every tick.

        It changes when the bus is opened again: ask after each `poll`.
        """
        raise NotImplementedError

    def send(self, frame: Frame) -> str | None:
        """Sends a frame now or not at all; returns None, or why it was not sent. The caller tells the master."""
        raise NotImplementedError

    def poll(self) -> list[Event]:
        """Returns what happened since the last call: at most 256 events; then call again before waiting."""
        raise NotImplementedError

    def close(self) -> None:
        """Closes the bus; sends nothing."""
