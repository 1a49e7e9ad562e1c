"""What can go wrong, told once."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

_logger = logging.getLogger(__name__)


class BusError(Exception):
    """A CAN bus could not be opened."""


class BusBusy(Exception):
    """A frame could not be sent."""


class Leaving(BusBusy):
    """What was sent has not left yet; a bus on which it never does is lost, and told, by itself."""


@dataclass(frozen=True)
class Fault:
    """Something wrong with the hardware.

    Attributes:
        code: a short stable word: "board-missing", "board-lost", "board-rebooted", "board-stopped", "wrong-device",
            "wrong-length", "sdo-refused", "emergency", "stuck", "unexpected-motion", "bus-off", "bus-down", "bus-busy",
            "bus-passive", "foreign-master" or "halted".
        source: a board ("can0/5"), a bus ("can0") or an actuator ("5.left (can0/5 output 0)").
        message: a sentence for a person.
    """

    code: str
    source: str
    message: str


class FaultLog:
    """Hands each fault to the subscribers once, until it is cleared.

    Of one code and source only the first counts: a board may report 65,280 emergencies, 8,000 a second.
    """

    def __init__(self) -> None:
        self._subscribers: list[Callable[[Fault], None]] = []
        self._told: set[tuple[str, str]] = set()
        self._lock = threading.Lock()

    def subscribe(self, callback: Callable[[Fault], None]) -> None:
        """Calls `callback` with each new fault, in the thread that found it."""
        self._subscribers.append(callback)

    def report(self, fault: Fault) -> None:
        """Hands a fault over, unless that was done already."""
        with self._lock:
            if (fault.code, fault.source) in self._told:
                return
            self._told.add((fault.code, fault.source))
        for callback in self._subscribers:
            try:
                callback(fault)
            except Exception:  # what a subscriber does wrong must not end the thread that reads the bus
                _logger.exception("a subscriber failed on %s", fault)

    def clear(self) -> None:
        """Forgets what was told, so that it is told again when it is still so."""
        with self._lock:
            self._told.clear()
