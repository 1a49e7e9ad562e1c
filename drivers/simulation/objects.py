"""The object dictionary of a simulated board, with the rules a board has for writing it."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable
from pathlib import Path

import canopen
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.datatypes import NUMBER_TYPES
from canopen.sdo.exceptions import SdoAbortedError

from drivers.canopen import cia301

EDS = Path(__file__).with_name("board.eds")

# Abort codes (CiA 301, 7.2.4.3.17).
_UNSUPPORTED, _WRITE_ONLY, _READ_ONLY = 0x0601_0000, 0x0601_0001, 0x0601_0002
_NO_OBJECT, _NO_SUB_INDEX = 0x0602_0000, 0x0609_0011
_NOT_MAPPABLE, _TOO_LONG, _WRONG_LENGTH, _WRONG_VALUE = 0x0604_0041, 0x0604_0042, 0x0607_0010, 0x0609_0030
_PDOS = (0x1400, 0x1800)

# The library logs each SDO, and a traceback for each malformed one, which anybody on the bus can send.
logging.getLogger("canopen.sdo").setLevel(logging.CRITICAL)


@functools.cache
def _described(node: int) -> canopen.ObjectDictionary:
    """What the EDS says, which takes milliseconds to read and is never changed; values are kept apart."""
    return canopen.import_od(str(EDS), node)


class Objects:
    """Values by index and sub-index. It stands in for canopen's LocalNode towards its SDO server.

    Args:
        node: node id, for the COB-IDs in the EDS.
        on_write: called with index and sub-index after an SDO write.

    Attributes:
        refused: abort codes with which single objects refuse every SDO; a board's faults and gaps.
    """

    def __init__(self, node: int, on_write: Callable[[int, int], None]) -> None:
        self.object_dictionary = _described(node)
        self.refused: dict[tuple[int, int], int] = {}
        self._on_write = on_write
        self._values: dict[tuple[int, int], bytes] = {}

    def reset(self, first: int = 0x1000, last: int = 0xFFFF) -> None:
        """Gives a range of indices its default values."""
        self._values = {key: value for key, value in self._values.items() if not first <= key[0] <= last}

    def number(self, index: int, sub: int = 0) -> int:
        """An unsigned value."""
        return int.from_bytes(self._value(index, sub), "little")

    def put(self, index: int, sub: int, value: int) -> None:
        """Sets an unsigned value from within the board."""
        self._values[index, sub] = value.to_bytes(len(self._value(index, sub)), "little")

    def get_data(self, index: int, sub: int, check_readable: bool = False) -> bytes:
        """What an SDO reads.

        Raises:
            SdoAbortedError: there is nothing to read.
        """
        self._refuse(index, sub)
        if check_readable and not self._find(index, sub).readable:
            raise SdoAbortedError(_WRITE_ONLY)
        return self._value(index, sub)

    def set_data(self, index: int, sub: int, data: bytes, check_writable: bool = False) -> None:
        """What an SDO writes.

        Raises:
            SdoAbortedError: the object may not be written, or not so, or not now.
        """
        self._refuse(index, sub)
        variable = self._find(index, sub)
        if check_writable and not variable.writable:
            raise SdoAbortedError(_READ_ONLY)
        if len(data) != len(self._value(index, sub)):
            raise SdoAbortedError(_WRONG_LENGTH)
        value = int.from_bytes(data, "little")
        if index in _PDOS:
            self._check_parameter(index, sub, value)
        elif index - 0x200 in _PDOS:
            self._check_mapping(index, sub, value)
        self._values[index, sub] = bytes(data)
        self._on_write(index, sub)

    def mapping(self, pdo: int) -> list[tuple[int, int, int]]:
        """The objects a PDO carries, as index, sub-index and bits; `pdo` is 1400h or 1800h."""
        entries = [self.number(pdo + 0x200, 1 + i) for i in range(self.number(pdo + 0x200, 0))]
        return [(entry >> 16, entry >> 8 & 0xFF, entry & 0xFF) for entry in entries]

    def _refuse(self, index: int, sub: int) -> None:
        if (index, sub) in self.refused:
            raise SdoAbortedError(self.refused[index, sub])

    def _check_parameter(self, index: int, sub: int, value: int) -> None:
        if sub == 1:
            now = self.number(index, 1)
            if not (now | value) & cia301.INVALID and now != value:
                raise SdoAbortedError(_WRONG_VALUE)  # only a PDO that is off may change its COB-ID
        elif sub == 2 and not (value in (254, 255) or (index == 0x1400 and value <= 240)):
            raise SdoAbortedError(_WRONG_VALUE)

    def _check_mapping(self, index: int, sub: int, value: int) -> None:
        """The order for mapping anew (CiA 301, 7.5.2.36)."""
        if not self.number(index - 0x200, 1) & cia301.INVALID or (sub != 0 and self.number(index, 0) != 0):
            raise SdoAbortedError(_UNSUPPORTED)
        if sub == 0:
            if value > 8:
                raise SdoAbortedError(_TOO_LONG)
            entries = [self.number(index, 1 + i) for i in range(value)]
            if sum(entry & 0xFF for entry in entries) > 64:
                raise SdoAbortedError(_TOO_LONG)
            return
        variable = self._find(value >> 16, value >> 8 & 0xFF)
        dummy = index == 0x1600 and value >> 16 <= 7
        if not (dummy or variable.pdo_mappable) or len(variable) != value & 0xFF:
            raise SdoAbortedError(_NOT_MAPPABLE)

    def _value(self, index: int, sub: int) -> bytes:
        variable = self._find(index, sub)
        if (index, sub) in self._values:
            return self._values[index, sub]
        if isinstance(variable.default, int) or variable.data_type in NUMBER_TYPES:
            return int(variable.default or 0).to_bytes(len(variable) // 8 or 1, "little")
        return str(variable.default or "").encode("ascii")

    def _find(self, index: int, sub: int) -> ODVariable:
        if index not in self.object_dictionary:
            raise SdoAbortedError(_NO_OBJECT)
        found = self.object_dictionary[index]
        if isinstance(found, ODVariable):
            if sub != 0:
                raise SdoAbortedError(_NO_SUB_INDEX)
            return found
        if sub not in found.subindices:  # an array of canopen makes up any other
            raise SdoAbortedError(_NO_SUB_INDEX)
        return found[sub]
