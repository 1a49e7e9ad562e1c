"""The error register, the error history and the emergency messages of a simulated board (CiA 301, 7.2.7)."""

from __future__ import annotations

import struct
from collections.abc import Callable

from drivers.simulation.objects import Objects

_COMMUNICATION = 0x11  # error register: generic and communication
_HISTORY = 8  # entries of 1003h


class Emergencies:
    """Tells of each error once when it comes, and once when it is over.

    Args:
        objects: whose 1001h and 1003h are kept.
        send: takes the 8 bytes of an emergency.
    """

    def __init__(self, objects: Objects, send: Callable[[bytes], None]) -> None:
        self._objects = objects
        self._send = send
        self._present: set[int] = set()

    def reset(self) -> None:
        """Forgets all errors, silently."""
        self._present.clear()

    def report(self, code: int) -> None:
        """Notes an error and tells of it, unless it is there already."""
        if code in self._present:
            return
        self._present.add(code)
        history = [code, *(self._objects.number(0x1003, sub) for sub in range(1, _HISTORY))]
        for sub, entry in enumerate(history, start=1):
            self._objects.put(0x1003, sub, entry)
        self._objects.put(0x1003, 0, sum(entry != 0 for entry in history))
        self._tell(code)

    def recover(self, code: int) -> None:
        """Tells that an error is over, if it was there."""
        if code in self._present:
            self._present.remove(code)
            self._tell(0)

    def clear_history(self) -> None:
        """Empties 1003h."""
        for sub in range(_HISTORY + 1):
            self._objects.put(0x1003, sub, 0)

    def _tell(self, code: int) -> None:
        register = _COMMUNICATION if self._present else 0
        self._objects.put(0x1001, 0, register)
        self._send(struct.pack("<HB5x", code, register))
