"""The values in the object dictionary of a simulated board, with the rules for writing them."""

from __future__ import annotations

import logging
from collections.abc import Callable

from canopen.sdo.exceptions import SdoAbortedError

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.simulation.dictionary import Object
from hyperbit.drivers.simulation.variants import Variant

# Abort codes (CiA 301, 7.2.4.3.17).
_UNSUPPORTED, _WRITE_ONLY, _READ_ONLY = 0x0601_0000, 0x0601_0001, 0x0601_0002
_NO_SUB_INDEX, _NO_DATA = 0x0609_0011, 0x0800_0024
_NOT_MAPPABLE, _TOO_LONG, _WRONG_LENGTH, _WRONG_VALUE = 0x0604_0041, 0x0604_0042, 0x0607_0010, 0x0609_0030
_INCOMPATIBLE = 0x0604_0043

_RPDOS, _RPDO_MAPS = range(0x1400, 0x1600), range(0x1600, 0x1800)
_TPDOS, _TPDO_MAPS = range(0x1800, 0x1A00), range(0x1A00, 0x1C00)
_MOST_BITS = 64  # of a PDO
_HISTORY, _CONSUMER = 0x1003, 0x1016
_TIMES = (0x100C, _CONSUMER, 0x1017)  # their low words are times [ms]

# The library logs each SDO, a malformed one with a traceback. Anybody on the bus can send such frames.
logging.getLogger("canopen.sdo").setLevel(logging.CRITICAL)


class Objects:
    """Values by index and sub-index. canopen's SDO server uses this class in place of a LocalNode.

    `on_write` is called with index and sub-index after an SDO write.
    """

    object_dictionary = None  # the SDO server reads this attribute, and does not use it

    def __init__(self, node: int, variant: Variant, on_write: Callable[[int, int], None]) -> None:
        # abort codes of objects that refuse every SDO, by index and sub-index
        self.refused: dict[tuple[int, int], int] = {}
        # functions whose number an SDO upload returns in place of the value, by index and sub-index
        self.shown: dict[tuple[int, int], Callable[[], int]] = {}
        self.flash_writes = 0  # number of writes to the flash memory
        self.node = node  # node id, which is part of COB-IDs
        self.variant = variant
        self.described = variant.objects
        self._on_write = on_write
        self.values: dict[tuple[int, int], bytes] = {}
        self.stored: dict[tuple[int, int], bytes] = {}
        for (index, sub), value in variant.stored.items():
            self.stored[index, sub] = value.to_bytes(self.find(index, sub).size, "little")

    def reset(self, first: int = 0x1000, last: int = 0xFFFF) -> None:
        """Resets a range of indices to the stored values, else to the default values."""
        self.values = {key: value for key, value in self.values.items() if not first <= key[0] <= last}

    def subs(self, index: int) -> range:
        """Returns the sub-indices of an array from 1; none if there is no such object."""
        return range(1, max(self.described.get(index, {0: None})) + 1)

    def has(self, index: int) -> bool:
        return index in self.described

    def number(self, index: int, sub: int = 0) -> int:
        """Returns an unsigned value; 0 if there is no such object."""
        if index not in self.described:
            return 0
        return int.from_bytes(self.value(index, sub), "little")

    def set_number(self, index: int, sub: int, value: int) -> None:
        self.values[index, sub] = value.to_bytes(self.find(index, sub).size, "little")

    def get_data(self, index: int, sub: int, check_readable: bool = False) -> bytes:
        """Returns a value for an SDO upload. Raises SdoAbortedError if it does not exist or is not readable."""
        self._refuse(index, sub)
        if check_readable and not self.find(index, sub).readable:
            raise SdoAbortedError(_WRITE_ONLY)
        if index == _HISTORY and self.number(_HISTORY) < sub in self.subs(_HISTORY):
            raise SdoAbortedError(_NO_DATA)
        if (index, sub) in self.shown:
            return self.shown[index, sub]().to_bytes(self.find(index, sub).size, "little")
        return self.value(index, sub)

    def set_data(self, index: int, sub: int, data: bytes, check_writable: bool = False) -> None:
        """Sets a value by an SDO download. Raises SdoAbortedError if this is not permitted, or not now."""
        self._refuse(index, sub)
        entry = self.find(index, sub)
        if check_writable and not entry.writable:
            raise SdoAbortedError(_READ_ONLY)
        if len(data) != entry.size:
            raise SdoAbortedError(_WRONG_LENGTH)
        value = int.from_bytes(data, "little")
        if index in _RPDOS or index in _TPDOS:
            self._check_parameter(index, sub, value)
        elif index in _RPDO_MAPS or index in _TPDO_MAPS:
            self._check_mapping(index, sub, value)
        elif self.variant.one_supervision:
            self._check_supervision(index, value)
        elif index == _CONSUMER:
            self._check_consumer(sub, value)
        if index in self.variant.deaf:
            return
        if index in _TIMES:
            value -= (value & 0xFFFF) % self.variant.time_step
        self.values[index, sub] = value.to_bytes(entry.size, "little")
        if self.variant.saves and index not in (_HISTORY, self.variant.output_object):
            self.flash_writes += 1
            self.stored[index, sub] = bytes(data)
        self._on_write(index, sub)

    def mapping(self, pdo: int) -> list[tuple[int, int, int]]:
        """Returns the mapping of a PDO as index, sub-index and bits; `pdo` is its index from 1400h or 1800h."""
        entries = [self.number(pdo + 0x200, 1 + i) for i in range(self.number(pdo + 0x200, 0))]
        return [(entry >> 16, entry >> 8 & 0xFF, entry & 0xFF) for entry in entries]

    def _refuse(self, index: int, sub: int) -> None:
        if (index, sub) in self.refused:
            raise SdoAbortedError(self.refused[index, sub])

    def _check_parameter(self, index: int, sub: int, value: int) -> None:
        if sub == 1:
            now = self.number(index, 1)
            if not (now | value) & cia301.INVALID and now != value:
                raise SdoAbortedError(_WRONG_VALUE)  # only the COB-ID of a disabled PDO may be changed
        elif sub == 2:
            synchronous = value <= 240 and index in _RPDOS and self.variant.synchronous
            if value < 254 and not synchronous:
                raise SdoAbortedError(_WRONG_VALUE)

    def _check_mapping(self, index: int, sub: int, value: int) -> None:
        """Checks the order of the writes to a mapping (CiA 301, 7.5.2.36)."""
        if not self.number(index - 0x200, 1) & cia301.INVALID or (sub != 0 and self.number(index, 0) != 0):
            raise SdoAbortedError(_UNSUPPORTED)
        if sub == 0:
            if value > max(self.subs(index)):
                raise SdoAbortedError(_TOO_LONG)
            entries = [self.number(index, 1 + i) for i in range(value)]
            if sum(entry & 0xFF for entry in entries) > _MOST_BITS:
                raise SdoAbortedError(_TOO_LONG)
            return
        entry = self.find(value >> 16, value >> 8 & 0xFF)
        dummy = index in _RPDO_MAPS and value >> 16 <= 7
        if not (dummy or entry.mappable) or 8 * entry.size != value & 0xFF:
            raise SdoAbortedError(_NOT_MAPPABLE)

    def _check_supervision(self, index: int, value: int) -> None:
        """Refuses node guarding while heartbeats are on, and vice versa."""
        guarding, heartbeat = self.number(0x100C) * self.number(0x100D), self.number(0x1017)
        others = {0x1017: guarding, 0x100C: heartbeat, 0x100D: heartbeat}
        if value and others.get(index):
            raise SdoAbortedError(_INCOMPATIBLE)

    def _check_consumer(self, sub: int, value: int) -> None:
        """Refuses a second heartbeat time for one node (CiA 301, 7.5.2.19)."""
        others = (self.number(_CONSUMER, other) for other in self.subs(_CONSUMER) if other != sub)
        if value & 0xFFFF and any(other & 0xFFFF and (other ^ value) >> 16 & 0x7F == 0 for other in others):
            raise SdoAbortedError(_INCOMPATIBLE)

    def value(self, index: int, sub: int) -> bytes:
        key = index, sub
        if (value := self.values.get(key, self.stored.get(key))) is not None:
            return value
        entry = self.find(index, sub)
        if not entry.relative:
            return entry.default
        return (int.from_bytes(entry.default, "little") + self.node).to_bytes(entry.size, "little")

    def find(self, index: int, sub: int) -> Object:
        if index not in self.described:
            raise SdoAbortedError(self.variant.no_object)
        if sub not in self.described[index]:
            raise SdoAbortedError(_NO_SUB_INDEX)
        return self.described[index][sub]
