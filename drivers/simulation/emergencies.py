"""The error register, the error history and the emergency messages of a simulated board (CiA 301, 7.2.7)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable

from drivers.simulation.objects import Objects
from drivers.simulation.variants import StandingError

_GENERIC = 0x01
_GROUPS = {2: 0x02, 3: 0x04, 4: 0x08, 8: 0x10}  # bits of 1001h by first digit: current, voltage, temperature, CAN
_MAKER, _MAKER_BIT = 0xFF, 0x80
_HISTORY = range(1, 9)  # entries of 1003h


class Emergencies:
    """Tells of each error once when it comes, and once when it is over.

    Args:
        objects: whose 1001h and 1003h are kept.
        send: takes the 8 bytes of an emergency.
    """

    def __init__(self, objects: Objects, send: Callable[[bytes], None]) -> None:
        self._objects = objects
        self._send = send
        self._present: dict[int, int] = {}  # bits of 1001h by code

    def reset(self) -> None:
        """Forgets all errors, silently."""
        self._present.clear()
        self._set_register()

    def restore(self, errors: Iterable[StandingError]) -> None:
        """Notes errors that stand, silently: they were told before."""
        for code, register in errors:
            self._note(code, register)

    def report(self, code: int, register: int | None = None) -> None:
        """Notes an error and tells of it, unless it is there already."""
        if code not in self._present:
            self._note(code, _register(code) if register is None else register)
            self._tell(code)

    def recover(self, code: int) -> None:
        """Tells that an error is over, if it was there."""
        if code in self._present:
            del self._present[code]
            self._set_register()
            self._tell(0)

    def clear_history(self) -> None:
        """Empties 1003h."""
        for sub in (0, *_HISTORY):
            self._objects.put(0x1003, sub, 0)

    def _note(self, code: int, register: int) -> None:
        self._present[code] = register
        history = [code, *(self._objects.number(0x1003, sub) for sub in _HISTORY[:-1])]
        for sub, entry in zip(_HISTORY, history, strict=True):
            self._objects.put(0x1003, sub, entry)
        self._objects.put(0x1003, 0, sum(entry != 0 for entry in history))
        self._set_register()

    def _set_register(self) -> int:
        register = 0
        for bits in self._present.values():
            register |= bits
        self._objects.put(0x1001, 0, register)
        return register

    def _tell(self, code: int) -> None:
        self._send(struct.pack("<HB5x", code, self._set_register()))


def _register(code: int) -> int:
    """The bits of 1001h for an error code."""
    return _GENERIC | (_MAKER_BIT if code >> 8 == _MAKER else _GROUPS.get(code >> 12, 0))
