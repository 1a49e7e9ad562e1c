"""Listens for the heartbeat of a master, such as an executor, and sends nothing."""

from __future__ import annotations

from collections.abc import Iterable

from drivers.canopen.tools.conversation import converse
from drivers.canopen.wire import cia301
from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.events import Event, FrameEchoed, FrameReceived
from drivers.canopen.wiring import MASTER, BusWiring

_SHORTEST, _PERIODS = 1.2, 1.5  # [s], and heartbeats of the master


class Listening:
    """Listens until a master is heard or the time is over; without I/O and clock, like the master.

    Attributes:
        master_on: name of the bus on which a master was heard; None if none was.

    Args:
        seconds: longest time to listen [s].
    """

    def __init__(self, seconds: float) -> None:
        self.master_on: str | None = None
        self._seconds, self._begun, self._now = seconds, 0.0, 0.0

    @property
    def over(self) -> bool:
        """Whether a master was heard, or the time is over."""
        return self.master_on is not None or self._now - self._begun >= self._seconds

    def start(self, now: float) -> None:
        """Begins. All buses are open."""
        self._begun = self._now = now

    def receive_event(self, event: Event, now: float) -> None:
        """Takes an event of a bus. Frames of an executor on this computer are echoes."""
        if (
            isinstance(event, FrameEchoed | FrameReceived)
            and event.frame.id == cia301.HEARTBEAT + MASTER
            and event.frame.data
        ):
            self.master_on = event.bus

    def send_failed(self, bus: str, frame: Frame, now: float) -> None:
        """Does nothing: no frame is sent."""

    def tick(self, now: float) -> None:
        """Call every millisecond."""
        self._now = now


def master_on(buses: Iterable[BusWiring], heartbeat: float = 0.0) -> str | None:
    """Listens on buses; returns the name of one on which a master sends its heartbeat, or None.

    Args:
        buses: the buses.
        heartbeat: period of the master's heartbeat [s], if it is known.

    Raises:
        BusError: a bus cannot be opened.
    """
    it = Listening(max(_SHORTEST, _PERIODS * heartbeat))
    converse(it, [], [CanBus(bus) for bus in buses])
    return it.master_on
