"""The error register, the error history and the emergency messages of a simulated board (CiA 301, 7.2.7)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable

from hyperbit.drivers.simulation.objects import Objects
from hyperbit.drivers.simulation.variants import StandingError

_GENERIC = 0x01
_GROUPS = {2: 0x02, 3: 0x04, 4: 0x08, 8: 0x10}  # bits of 1001h by first digit: current, voltage, temperature, CAN
_MAKER, _MAKER_BIT = 0xFF, 0x80
_HISTORY = range(1, 9)  # entries of 1003h
_ERROR_NUMBERS = {0x8130: 0x1B, 0x8140: 0x12, 0x8100: 0x18}  # CANopenNode's, in the highest byte of an entry
_OTHER_NUMBER = 0x30  # of an error of the maker


class Emergencies:
    """Sends one emergency when an error begins, and one when it ends.

    `objects` has 1001h and 1003h; `send` takes 8 bytes. `logs_ends`: whether the end of an error is an entry of 1003h
    too, with the error code 0000h.
    """

    def __init__(self, objects: Objects, send: Callable[[bytes], None], *, logs_ends: bool) -> None:
        self._logs_ends = logs_ends
        self._objects = objects
        self._send = send
        self.present: dict[int, int] = {}  # bits of 1001h by code

    def reset(self) -> None:
        self.present.clear()
        self._set_register()

    def restore(self, errors: Iterable[StandingError]) -> None:
        """Sets standing errors without an emergency: an earlier one reported them."""
        for code, register in errors:
            self._note(code, register)

    def report(self, code: int, register: int | None = None) -> None:
        """Starts an error and sends its emergency, unless the error stands already."""
        if code not in self.present:
            self._note(code, _register(code) if register is None else register)
            self._tell(code)

    def recover(self, code: int) -> None:
        """Ends a standing error, and sends the emergency 0000h."""
        if code in self.present:
            del self.present[code]
            register = self._set_register()
            if self._logs_ends:
                self._log(_number(code) << 24 | register << 16)
            self._tell(0)

    def clear_history(self) -> None:
        for sub in (0, *_HISTORY):
            self._objects.set_number(0x1003, sub, 0)

    def _note(self, code: int, register: int) -> None:
        self.present[code] = register
        present = self._set_register()
        self._log((_number(code) << 24 | present << 16 | code) if self._logs_ends else code)

    def _log(self, newest: int) -> None:
        if not self._objects.has(0x1003):
            return
        history = [newest, *(self._objects.number(0x1003, sub) for sub in _HISTORY[:-1])]
        for sub, entry in zip(_HISTORY, history, strict=True):
            self._objects.set_number(0x1003, sub, entry)
        self._objects.set_number(0x1003, 0, min(self._objects.number(0x1003) + 1, len(_HISTORY)))

    def _set_register(self) -> int:
        register = 0
        for bits in self.present.values():
            register |= bits
        self._objects.set_number(0x1001, 0, register)
        return register

    def _tell(self, code: int) -> None:
        self._send(struct.pack("<HB5x", code, self._set_register()))


def _number(code: int) -> int:
    return _ERROR_NUMBERS.get(code) or _OTHER_NUMBER + code % 0x10


def _register(code: int) -> int:
    """Returns the bits of 1001h for an error code."""
    return _GENERIC | (_MAKER_BIT if code >> 8 == _MAKER else _GROUPS.get(code >> 12, 0))
