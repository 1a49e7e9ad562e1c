"""The outputs of a simulated board: bytes, polarity and error mode (CiA 401)."""

from __future__ import annotations

from collections.abc import Iterable

from drivers.simulation.objects import Objects
from drivers.simulation.variants import Variant

_POLARITY, _ERROR_MODE, _ERROR_VALUE = 0x6202, 0x6206, 0x6207


class Outputs:
    """Levels of the outputs, from 6200h or the maker's object.

    Args:
        objects: object dictionary of the board.
        variant: variant of the board.
    """

    def __init__(self, objects: Objects, variant: Variant) -> None:
        self._objects = objects
        self._variant = variant
        self._index = variant.output_object
        self._subs = objects.subs(self._index)
        self._hidden: int | None = None  # levels in the error state, if the object does not show them

    @property
    def levels(self) -> int:
        """Levels of the outputs; bit k is output k."""
        if self._hidden is not None:
            return self._hidden
        return self._levels([self._objects.number(self._index, sub) for sub in self._subs])

    def take(self, entries: Iterable[tuple[int, int, int]], data: bytes) -> None:
        """Applies the data of an RPDO; entries are index, sub-index and bits."""
        value = int.from_bytes(data, "little")
        for index, sub, bits in entries:
            if index > 7:  # 0001h to 0007h are dummy entries (CiA 301, 7.4.7)
                self._objects.put(index, sub, value & (1 << bits) - 1)
            if index == self._index:
                self._hidden = None
            value >>= bits

    def written(self, index: int) -> bool:
        """Call after an SDO write; returns whether levels may have changed."""
        if index == self._index:
            self._hidden = None
        return index in (self._index, _POLARITY)

    def fail_safe(self) -> None:
        """Enters the error state: outputs take their error value, 6207h, where the error mode, 6206h, says so."""
        values = []
        for sub in self._subs:
            mode, value = 0xFF if self._variant.error_state == "off" else 0, 0
            if self._variant.error_state == "modes":
                mode, value = self._objects.number(_ERROR_MODE, sub), self._objects.number(_ERROR_VALUE, sub)
            values.append(self._objects.number(self._index, sub) & ~mode | value & mode)
        if not self._variant.shows_error_state:
            self._hidden = self._levels(values)
            return
        for sub, value in zip(self._subs, values, strict=True):
            self._objects.put(self._index, sub, value)

    def reset(self) -> None:
        """Forgets the error state."""
        self._hidden = None

    def _levels(self, values: list[int]) -> int:
        inverted = (self._objects.number(_POLARITY, sub) if self._objects.has(_POLARITY) else 0 for sub in self._subs)
        return int.from_bytes(bytes(v ^ i for v, i in zip(values, inverted, strict=True)), "little")
