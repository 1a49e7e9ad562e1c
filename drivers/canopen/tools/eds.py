"""A board made from its electronic data sheet (EDS, CiA 306-1), which answers SDO transfers in process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import canopen
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.datatypes import NUMBER_TYPES

from drivers.canopen.sdo import objects
from drivers.canopen.sdo.client import SdoOutcome, Transfer
from drivers.canopen.sdo.procedure import DONE, Ask, Step

# SDO abort codes (CiA 301, 7.2.4.3.17).
_WRITE_ONLY, _NOT_MAPPABLE = 0x0601_0001, 0x0604_0041
_WRONG_LENGTH, _TOO_HIGH, _TOO_LOW = 0x0607_0010, 0x0609_0031, 0x0609_0032

_RPDO_MAPPINGS, _TPDO_MAPPINGS = range(0x1600, 0x1800), range(0x1A00, 0x1C00)
_DUMMIES = range(1, 8)  # indices of the dummy entries of RPDOs
_ALL_PARTS = 0xFE  # greatest number of sub-indices
_ANY_DEVICE = 0x000F_0191  # 1000h: CiA 401 with inputs and outputs


class UnreadableEds(ValueError):
    """The file cannot be read as an EDS; the text says why."""


def is_mapping(index: int) -> bool:
    """Returns whether an object is the mapping of a PDO."""
    return index in _RPDO_MAPPINGS or index in _TPDO_MAPPINGS


@dataclass(frozen=True)
class EdsTransfer:
    """One transfer, as the board has answered it.

    Attributes:
        index: index of the object.
        sub: sub-index.
        written: the value to write; None: a read.
        abort: abort code; None: done.
    """

    index: int
    sub: int
    written: int | None
    abort: int | None


class Eds:
    """The object dictionary of an EDS.

    Args:
        path: path of the file.
        node: node id, which is part of COB-IDs.

    Raises:
        UnreadableEds: the file is missing, or cannot be read as an EDS.
    """

    def __init__(self, path: Path, node: int) -> None:
        try:
            with path.open(encoding="utf-8-sig", errors="replace") as file:
                self._objects = canopen.import_od(file, node)
        except OSError as error:
            raise UnreadableEds(error.strerror or str(error)) from None
        except Exception as error:  # the parser of the library raises many types
            raise UnreadableEds(f"no EDS: {type(error).__name__}: {error}") from None
        if not len(self._objects):
            raise UnreadableEds("no EDS: it describes no object")
        information = self._objects.device_information
        self.fixed_mappings = information.granularity is not None and not information.granularity
        self._numbers = {"NrOfRXPDO": information.nr_of_RXPDO, "NrOfTXPDO": information.nr_of_TXPDO}
        self._beyond = {
            index: key
            for (key, number), first in zip(self._numbers.items(), (0x1400, 0x1800), strict=True)
            if number is not None
            for index in sorted(i for i in self._objects.indices if first <= i < first + 0x200)[number:]
        }

    def find(self, index: int, sub: int) -> ODVariable | None:
        """Returns an entry of the dictionary; None if it is absent."""
        found = self._objects.indices.get(index)
        if found is None or index in self._beyond:
            return None
        if isinstance(found, ODVariable):
            return found if sub == 0 else None
        entry = found.subindices.get(sub)
        if entry is None and 1 in found.subindices and 0 < sub <= (self.default(index, 0) or 0):
            entry = found[sub]  # an array that is described once: all entries are like the first
        return entry if isinstance(entry, ODVariable) else None

    def default(self, index: int, sub: int) -> int | None:
        """Returns the default value; None if the EDS does not tell."""
        entry = self.find(index, sub)
        value = None if entry is None else entry.default
        return value if isinstance(value, int) else None

    def size(self, entry: ODVariable) -> int:
        """Returns the length of an entry [bytes]; 0 if it is no number."""
        return len(entry) // 8 or 1 if entry.data_type in NUMBER_TYPES or entry.data_type in _DUMMIES else 0

    def subs(self, index: int) -> int:
        """Returns the greatest sub-index of an object that is described."""
        found = self._objects.indices.get(index)
        return 0 if found is None or isinstance(found, ODVariable) else max(found.subindices, default=0)

    def says(self, index: int, sub: int) -> str:
        """Returns what the EDS says about an entry, in words."""
        if index in _DUMMIES:
            return f"Dummy{index:04d}={int(index in self._objects.indices)}"
        if index in self._beyond:
            return f"{self._beyond[index]}={self._numbers[self._beyond[index]]}"
        entry = self.find(index, sub)
        if entry is None:
            return "nothing of it"
        told = {
            "AccessType": entry.access_type,
            "PDOMapping": int(bool(entry.pdo_mappable)),
            "DataType": f"{entry.data_type or 0:#06x}",
            "LowLimit": entry.min,
            "HighLimit": entry.max,
            "DefaultValue": None if (value := self.default(index, sub)) is None else f"{value:#x}",
            "Granularity": 0 if is_mapping(index) and self.fixed_mappings else None,
        }
        return ", ".join(f"{key}={value}" for key, value in told.items() if value is not None)


class EdsBoard:
    """A board with the object dictionary of an EDS and its default values.

    Attributes:
        asked: all transfers, in order.

    Args:
        eds: the EDS.
        assumed: values that count in place of those of the EDS, by index and sub-index.
        absent: indices of objects that the EDS lacks, and the board has nevertheless.
        writable: objects that accept any value, by index and sub-index.
    """

    def __init__(
        self, eds: Eds, assumed: dict[tuple[int, int], int], absent: set[int], writable: set[tuple[int, int]]
    ) -> None:
        self.asked: list[EdsTransfer] = []
        self._eds, self._absent, self._writable = eds, absent, writable
        self._values = dict(assumed)

    def answer(self, step: Step) -> SdoOutcome:
        """Answers a step of a procedure at once. NMT commands and waits succeed."""
        transfer = step.transfer if isinstance(step, Ask) else step
        if not isinstance(transfer, Transfer):
            return DONE
        place = transfer.index, transfer.sub
        data = b""
        if transfer.data is None:
            written = None
            abort = self._reading(*place)
            if abort is None:
                data = self._read(*place)
        else:
            written = int.from_bytes(transfer.data, "little")
            abort = None if self._free(*place) else self._writing(*place, written, len(transfer.data))
            if abort is None:
                self._values[place] = written
        self.asked.append(EdsTransfer(*place, written, abort))
        return SdoOutcome(data=data) if abort is None else SdoOutcome(abort=abort)

    def _free(self, index: int, sub: int) -> bool:
        return index in self._absent or (index, sub) in self._writable

    def _missing(self, index: int, sub: int) -> int | None:
        """Returns the abort code for an object that does not exist."""
        if self._eds.find(index, sub) is not None:
            return None
        return objects.NO_OBJECT if self._eds.find(index, 0) is None else objects.NO_SUB_INDEX

    def _reading(self, index: int, sub: int) -> int | None:
        if self._free(index, sub):
            return None
        if (missing := self._missing(index, sub)) is not None:
            return missing
        entry = self._eds.find(index, sub)
        return None if entry is None or entry.readable else _WRITE_ONLY

    def _read(self, index: int, sub: int) -> bytes:
        entry = self._eds.find(index, sub)
        value = self._values.get((index, sub), self._default(index, sub))
        size = 4 if entry is None or self._free(index, sub) else self._eds.size(entry)
        return (value & (1 << 8 * size) - 1).to_bytes(size, "little")

    def _default(self, index: int, sub: int) -> int:
        """Returns the default value; where the EDS does not tell it, the number of entries, or 0."""
        if (value := self._eds.default(index, sub)) is not None:
            return value
        if sub == 0 and index in self._absent and not is_mapping(index):
            return _ALL_PARTS
        return _ANY_DEVICE if index == 0x1000 else self._eds.subs(index) * (sub == 0 and not is_mapping(index))

    def _writing(self, index: int, sub: int, value: int, size: int) -> int | None:
        if (missing := self._missing(index, sub)) is not None:
            return missing
        entry = self._eds.find(index, sub)
        assert entry is not None
        if not entry.writable or (is_mapping(index) and self._eds.fixed_mappings):
            return objects.READ_ONLY
        if size != self._eds.size(entry):
            return _WRONG_LENGTH
        if entry.min is not None and value < entry.min:
            return _TOO_LOW
        if entry.max is not None and value > entry.max:
            return _TOO_HIGH
        return self._mapping(index, value) if is_mapping(index) and sub else None

    def _mapping(self, index: int, entry: int) -> int | None:
        """Returns the abort code for a mapped object that does not exist, or cannot be mapped in this length."""
        place, bits = (entry >> 16, entry >> 8 & 0xFF), entry & 0xFF
        if self._free(*place):
            return None
        mapped = self._eds.find(*place)
        if mapped is None:
            return _NOT_MAPPABLE if place[0] in _DUMMIES else self._missing(*place)
        dummy = place[0] in _DUMMIES and index in _RPDO_MAPPINGS
        width = 1 if mapped.data_type == 1 else 8 * self._eds.size(mapped)
        return None if (dummy or mapped.pdo_mappable) and width == bits else _NOT_MAPPABLE
