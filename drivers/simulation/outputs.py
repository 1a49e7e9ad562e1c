"""The outputs of a simulated board: the command in 6200h, the pins, polarity and error mode (CiA 401)."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.simulation.objects import Objects
from hyperbit.drivers.simulation.variants import Variant

_POLARITY, _ERROR_MODE, _ERROR_VALUE = 0x6202, 0x6206, 0x6207


class SimulatedOutputs:
    """The levels of the pins, which follow from the last command, the error state and the NMT state.

    The command is 6200h or the maker's object. The error state never changes the command. It begins when the board
    loses the master or is stopped, and ends when the board enters operational: then the pins follow the command.
    In the error state each byte follows what was written last: the command, or 6206h and 6207h.
    """

    def __init__(self, objects: Objects, variant: Variant) -> None:
        self._objects = objects
        self._variant = variant
        self._index = variant.output_object
        self._subs = objects.subs(self._index)
        self._has_polarity = objects.has(_POLARITY)
        self._failing = False
        self._failed: set[int] = set()  # sub-indices of the bytes that follow the error state
        if variant.shows_error_state:
            objects.shown = {(self._index, sub): partial(self._driven, sub) for sub in self._subs}

    def pins(self, state: State | None) -> int:
        """Returns the levels of the pins in an NMT state, None while the board starts; bit k is output k."""
        if self._variant.off_outside_operational and state is not State.OPERATIONAL:
            return 0
        return int.from_bytes(bytes(self._pins(sub) for sub in self._subs), "little")

    def receive_rpdo(self, entries: Iterable[tuple[int, int, int]], data: bytes) -> None:
        """Applies the data of an RPDO; entries are index, sub-index and bits."""
        value = int.from_bytes(data, "little")
        for index, sub, bits in entries:
            if index > 7:  # 0001h to 0007h are dummy entries (CiA 301, 7.4.7)
                self._objects.set_number(index, sub, value & (1 << bits) - 1)
                self.written(index, sub)
            value >>= bits

    def written(self, index: int, sub: int) -> bool:
        """Call after a write; returns whether pins may have changed."""
        if index == self._index:
            self._failed.discard(sub)
        elif index in (_ERROR_MODE, _ERROR_VALUE) and self._failing:
            self._failed.add(sub)
        return index in (self._index, _POLARITY, _ERROR_MODE, _ERROR_VALUE)

    def fail_safe(self) -> None:
        self._failing = True
        self._failed.update(self._subs)

    def recover(self) -> None:
        self._failing = False
        self._failed.clear()

    def _pins(self, sub: int) -> int:
        inverted = self._objects.number(_POLARITY, sub) if self._has_polarity else 0
        return self._driven(sub) ^ inverted

    def _driven(self, sub: int) -> int:
        """Returns the byte before its polarity."""
        command = self._objects.number(self._index, sub)
        if sub not in self._failed or self._variant.error_state == "hold":
            return command
        if self._variant.error_state == "off":
            return 0
        mode, value = self._objects.number(_ERROR_MODE, sub), self._objects.number(_ERROR_VALUE, sub)
        return command & ~mode | value & mode
