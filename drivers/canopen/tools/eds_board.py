"""A board made from its electronic data sheet (EDS, CiA 306-1), which answers SDO transfers in process."""

from __future__ import annotations

from dataclasses import dataclass

from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.procedure import DONE, Ask, Step
from hyperbit.drivers.canopen.tools.eds import Eds, is_mapping

# SDO abort codes (CiA 301, 7.2.4.3.17).
_WRITE_ONLY, _NOT_MAPPABLE = 0x0601_0001, 0x0604_0041
_WRONG_LENGTH, _TOO_HIGH, _TOO_LOW = 0x0607_0010, 0x0609_0031, 0x0609_0032

_ALL_PARTS = 0xFE  # greatest number of sub-indices
_ANY_DEVICE = 0x000F_0191  # 1000h: CiA 401 with inputs and outputs
_BOOLEAN, _LAST_DUMMY = 1, 7  # data type, and index


@dataclass(frozen=True)
class EdsTransfer:
    """One transfer and the board's answer."""

    index: int
    sub: int
    written: int | None  # the value to write; None: a read
    abort: int | None  # code; None: done
    # index and sub-index of the entry that decides the answer: for a refused mapping, the mapped one
    blamed: tuple[int, int]
    told: bool  # the EDS gives all facts on which the answer depends


class EdsBoard:
    """A board with the object dictionary of an EDS and its values after power-on.

    Args:
        assumed: values that replace those of the EDS, by index and sub-index.
        absent: indices of objects that the EDS lacks, and the board has nevertheless.
        writable: entries that accept any value, by index and sub-index.
    """

    def __init__(
        self, eds: Eds, assumed: dict[tuple[int, int], int], absent: set[int], writable: set[tuple[int, int]]
    ) -> None:
        self.asked: list[EdsTransfer] = []  # all transfers, in order
        self._eds, self._absent, self._writable = eds, absent, writable
        self._values = dict(assumed)

    def answer(self, step: Step) -> SdoOutcome:
        """Answers a step of a procedure at once. NMT commands and waits succeed."""
        transfer = step.transfer if isinstance(step, Ask) else step
        if not isinstance(transfer, Transfer):
            return DONE
        blamed = place = transfer.index, transfer.sub
        data, abort, written, told = b"", None, None, self._told(*place, transfer.data is None)
        if transfer.data is None:
            if not self._free(*place):
                abort = self._reading(*place)
            if abort is None:
                data = self._read(*place)
        else:
            written = int.from_bytes(transfer.data, "little")
            if not self._free(*place):
                abort, blamed = self._writing(*place, written, len(transfer.data))
            if abort is None:
                self._values[place] = written
            elif blamed != place:
                told = blamed[0] not in self._eds.of_modules
            elif abort == _TOO_HIGH and transfer.index == 0x1016:  # a limit below all node ids is a mistake
                entry = self._eds.find(*place)
                told = entry is None or (entry.high or 0) >> 16 > 0
        self.asked.append(EdsTransfer(*place, written, abort, blamed, told))
        return SdoOutcome(data=data) if abort is None else SdoOutcome(abort=abort)

    def _told(self, index: int, sub: int, read: bool) -> bool:
        """Returns whether the EDS gives all facts for a transfer, or the value was written before."""
        entry = self._eds.find(index, sub)
        if entry is None:
            return index not in self._eds.of_modules
        counted = sub == 0 and not is_mapping(index)  # the sections give the number of entries
        valued = counted or entry.value is not None or (index, sub) in self._values
        return entry.access is not None and entry.size > 0 and (valued or not read)

    def _free(self, index: int, sub: int) -> bool:
        return index in self._absent or (index, sub) in self._writable

    def _missing(self, index: int, sub: int) -> int | None:
        if self._eds.find(index, sub) is not None:
            return None
        return objects.NO_OBJECT if self._eds.find(index, 0) is None else objects.NO_SUB_INDEX

    def _reading(self, index: int, sub: int) -> int | None:
        entry = self._eds.find(index, sub)
        return _WRITE_ONLY if entry is not None and not entry.readable else self._missing(index, sub)

    def _read(self, index: int, sub: int) -> bytes:
        entry = self._eds.find(index, sub)
        value = self._values.get((index, sub), self._value(index, sub))
        size = 4 if entry is None or self._free(index, sub) else entry.size
        return (value & (1 << 8 * size) - 1).to_bytes(size, "little")

    def _value(self, index: int, sub: int) -> int:
        """Returns the value after power-on. Where the EDS lacks it: the number of entries, or 0."""
        if (value := self._eds.value(index, sub)) is not None:
            return value
        if index == 0x1000:
            return _ANY_DEVICE
        if sub == 0 and index in self._absent and not is_mapping(index):
            return _ALL_PARTS
        return self._eds.subs(index) * (sub == 0 and not is_mapping(index))

    def _writing(self, index: int, sub: int, value: int, size: int) -> tuple[int | None, tuple[int, int]]:
        """Returns the abort code of a write, and the entry that decides it."""
        entry, place = self._eds.find(index, sub), (index, sub)
        if entry is None:
            return self._missing(index, sub), place
        if not entry.writable or (is_mapping(index) and self._eds.fixed_mappings):
            return objects.READ_ONLY, place
        if size != entry.size:
            return _WRONG_LENGTH, place
        if entry.low is not None and value < entry.low:
            return _TOO_LOW, place
        if entry.high is not None and value > entry.high:
            return _TOO_HIGH, place
        if not is_mapping(index) or not sub:
            return None, place
        mapped = value >> 16, value >> 8 & 0xFF
        return self._mapping(mapped, value & 0xFF, index < 0x1800), mapped

    def _mapping(self, place: tuple[int, int], bits: int, rpdo: bool) -> int | None:
        """Returns the abort code for a mapped object that does not exist, or cannot be mapped in this length."""
        if self._free(*place):
            return None
        mapped, dummy = self._eds.find(*place), place[0] <= _LAST_DUMMY
        if mapped is None:
            return _NOT_MAPPABLE if dummy else self._missing(*place)
        right = rpdo if dummy else mapped.mappable and not (rpdo and mapped.access in ("ro", "const"))
        width = 1 if mapped.data_type == _BOOLEAN else 8 * mapped.size
        return None if right and width == bits else _NOT_MAPPABLE
