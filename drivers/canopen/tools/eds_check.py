"""Compares the needs of a wiring with the EDS of a board, without a bus, by the steps of the boot."""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

from hyperbit.drivers.canopen.boot import board_needs
from hyperbit.drivers.canopen.boot.board_boot import configure
from hyperbit.drivers.canopen.boot.inspection import Inspection, inspect
from hyperbit.drivers.canopen.boot.pdo_search import find_pdos
from hyperbit.drivers.canopen.boot.pdo_state import MOST_ENTRIES
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import INPUTS, subs_of
from hyperbit.drivers.canopen.sdo import errors
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.objects import NO_OBJECT, NO_SUB_INDEX, READ_ONLY, Place
from hyperbit.drivers.canopen.sdo.procedure import Ask, BoardError, Procedure, Step
from hyperbit.drivers.canopen.tools.eds import Eds, is_mapping
from hyperbit.drivers.canopen.wiring import Timing

# SDO abort codes (CiA 301, 7.2.4.3.17).
_WRITE_ONLY, _NOT_MAPPABLE = 0x0601_0001, 0x0604_0041
_WRONG_LENGTH, _TOO_HIGH, _TOO_LOW = 0x0607_0010, 0x0609_0031, 0x0609_0032

_MOST_LACKS = 64
_ALL_PARTS = 0xFE  # greatest number of sub-indices
_ANY_DEVICE = 0x000F_0191  # 1000h: CiA 401 with inputs and outputs
_PDO_PARAMETERS = (*range(0x1400, 0x1600), *range(0x1800, 0x1A00))
_BOOLEAN, _LAST_DUMMY = 1, 7  # data type, and index


class Lack(NamedTuple):
    """A need of the wiring that the EDS does not meet."""

    object: str  # index and sub-index
    says: str  # about this object in the EDS
    needed: str  # why the boot refuses the board
    told: bool  # False: modules bring the object, or its value or access is missing in the EDS

    def __str__(self) -> str:
        return f"{self.object}: the EDS says {self.says}; {self.needed}"


class Refused(NamedTuple):
    """A transfer that the EDS refuses."""

    abort: int  # code
    blamed: Place  # the entry that decides: for a refused mapping, the mapped one
    told: bool  # the EDS gives all facts on which the answer depends


def lacks(eds: Eds, board: BoardLayout, timing: Timing) -> list[Lack]:
    """Returns the needs of a board's wiring that contradict its EDS; see `unmet`."""
    return [lack for lack in unmet(eds, board, timing) if lack.told]


def unmet(eds: Eds, board: BoardLayout, timing: Timing) -> list[Lack]:
    """Returns all needs of a board's wiring that its EDS does not meet, or does not mention."""
    objects = _Sheet(eds, board)
    try:
        for _ in _steps(Inspection(board, objects, timing)):
            raise AssertionError("no step but a transfer")
    except BoardError:  # no more lacks are told
        pass
    return list(objects.lacks.values())


def _steps(it: Inspection) -> Procedure:
    """The steps of the boot that depend on the object dictionary."""
    yield from it.objects.read(0x1000, 0, 4)
    yield from inspect(it)
    yield from find_pdos(it, in_full=True)
    yield from configure(it)
    yield from it.objects.meet(it.error_mode)
    yield from errors.read(it.objects)
    board = it.layout
    for index, bits in ((board.settings.object, board.output_bits), (INPUTS, board.input_bits)):
        for sub in subs_of(bits):
            yield from it.objects.read(index, sub)


class _Sheet(Dictionary):
    """Answers from an EDS, with its values after power-on. A refusal is noted, and from then on its need is met."""

    def __init__(self, eds: Eds, board: BoardLayout) -> None:
        super().__init__(board.name)
        self.lacks: dict[str, Lack] = {}  # by the refusal
        self._eds, self._watched = eds, board.watched
        self._refused: dict[Place, Refused] = {}  # the last refusal at each place
        self._absent = set[int]()  # indices that the EDS lacks, taken as present
        self._writable = set[Place]()  # entries that accept any value
        # The identity of the arm's file where the EDS has 0 or nothing: only the device has it.
        self._identity = {
            need.at: need.value for need in board_needs.identity(board.settings) if not eds.value(*need.at)
        }

    def transfer(self, step: Transfer | Ask) -> Generator[Step, SdoOutcome, SdoOutcome]:
        yield from ()
        it = step.transfer if isinstance(step, Ask) else step
        free = it.index in self._absent or it.place in self._writable
        if it.data is None:
            refused = None if free else self._reading(*it.place)
            data = self._value(it.index, it.sub, free)
        else:
            refused = None if free else self._writing(*it.place, int.from_bytes(it.data, "little"), len(it.data))
            data = b""
        if refused is None:
            return SdoOutcome(data=data)
        self._refused[it.place] = refused
        return SdoOutcome(abort=refused.abort)

    def refuse(self, code: str, text: str, *places: Place) -> None:
        """Notes a lack, and takes the need as met. A second refusal in the same words ends the procedure."""
        if text in self.lacks or len(self.lacks) >= _MOST_LACKS:
            super().refuse(code, text, *places)
        causes = [place for place in places if place in self._refused] or list(places[:1])
        self.lacks[text] = self._lack(causes[0], places, text)
        for place in causes:
            self._take_as_met(place)

    def _lack(self, cause: Place, places: tuple[Place, ...], text: str) -> Lack:
        known = self._told(*cause, read=True)
        abort, blamed, told = self._refused.get(cause, Refused(0, cause, known))
        if abort == READ_ONLY:  # an unwritable value may be right if the EDS does not give it
            indices = {index for index, _ in places}
            told = told and all(self._told(*place, read=True) for place in self.values if place[0] in indices)
        entry = self._eds.find(*blamed)
        if entry is not None and blamed in self._watched:  # access and data type decide, not the value
            told = entry.access is not None and entry.size > 0
        text = text.removeprefix(f"board {self.board}: ")
        if text.startswith(own := f"board {self.board} "):
            text = f"the board {text.removeprefix(own)}"
        return Lack(f"{blamed[0]:04X}h sub {blamed[1]}", self._eds.says(*blamed), text, told)

    def _take_as_met(self, cause: Place) -> None:
        index, sub = self._refused[cause].blamed if cause in self._refused else cause
        if self._eds.find(index, 0) is None:
            self._absent |= {index, index + 0x200} if index in _PDO_PARAMETERS else {index}
        elif is_mapping(index):
            self._writable.update((index, each) for each in range(1 + MOST_ENTRIES))
        else:
            self._writable.add((index, sub))
        if cause not in self.values:
            self.values[cause] = int.from_bytes(self._value(*cause, free=True), "little")

    def _told(self, index: int, sub: int, read: bool) -> bool:
        """Returns whether the EDS gives all facts for a transfer."""
        entry = self._eds.find(index, sub)
        if entry is None:
            return index not in self._eds.of_modules
        counted = sub == 0 and not is_mapping(index)  # the sections give the number of entries
        return entry.access is not None and entry.size > 0 and (counted or entry.value is not None or not read)

    def _missing(self, index: int, sub: int) -> int | None:
        if self._eds.find(index, sub) is not None:
            return None
        return NO_OBJECT if self._eds.find(index, 0) is None else NO_SUB_INDEX

    def _reading(self, index: int, sub: int) -> Refused | None:
        entry, place = self._eds.find(index, sub), (index, sub)
        abort = _WRITE_ONLY if entry is not None and not entry.readable else self._missing(index, sub)
        return None if abort is None else Refused(abort, place, self._told(index, sub, read=True))

    def _value(self, index: int, sub: int, free: bool) -> bytes:
        """Returns the value that was written, or that after power-on."""
        entry = self._eds.find(index, sub)
        value = self.values.get((index, sub), self._identity.get((index, sub)))
        if value is None and entry is not None:
            value = entry.value
        if value is None and sub == 0 and not is_mapping(index):  # the number of entries
            value = _ALL_PARTS if index in self._absent else self._eds.subs(index)
        if index == 0x1000 and (entry is None or entry.value is None):
            value = _ANY_DEVICE
        size = 4 if entry is None or free else entry.size
        return ((value or 0) & (1 << 8 * size) - 1).to_bytes(size, "little")

    def _writing(self, index: int, sub: int, value: int, size: int) -> Refused | None:
        entry, place = self._eds.find(index, sub), (index, sub)
        blamed, told = place, self._told(index, sub, read=False)
        if entry is None:
            abort = self._missing(index, sub)
        elif not entry.writable or (is_mapping(index) and self._eds.fixed_mappings):
            abort = READ_ONLY
        elif size != entry.size:
            abort = _WRONG_LENGTH
        elif entry.low is not None and value < entry.low:
            abort = _TOO_LOW
        elif entry.high is not None and value > entry.high:
            abort = _TOO_HIGH
            told = told and (index != 0x1016 or entry.high >> 16 > 0)  # a limit below all node ids is a mistake
        elif is_mapping(index) and sub:
            blamed = value >> 16, value >> 8 & 0xFF
            abort, told = self._mapping(blamed, value & 0xFF, index < 0x1800), blamed[0] not in self._eds.of_modules
        else:
            abort = None
        return None if abort is None else Refused(abort, blamed, told)

    def _mapping(self, place: Place, bits: int, rpdo: bool) -> int | None:
        """Returns the abort code for a mapped object that does not exist, or cannot be mapped in this length."""
        if place[0] in self._absent or place in self._writable:
            return None
        mapped, dummy = self._eds.find(*place), place[0] <= _LAST_DUMMY
        if mapped is None:
            return _NOT_MAPPABLE if dummy else self._missing(*place)
        right = rpdo if dummy else mapped.mappable and not (rpdo and mapped.access in ("ro", "const"))
        width = 1 if mapped.data_type == _BOOLEAN else 8 * mapped.size
        return None if right and width == bits else _NOT_MAPPABLE
