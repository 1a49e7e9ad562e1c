"""Unsigned numbers in a board's object dictionary: what they need to be, and why a board refuses them."""

from __future__ import annotations

from dataclasses import dataclass

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.sdo.client import SdoOutcome

# SDO abort codes (CiA 301, 7.2.4.3.17).
NO_OBJECT, NO_SUB_INDEX, READ_ONLY = 0x0602_0000, 0x0609_0011, 0x0601_0002
UNSUPPORTED, GENERAL, NO_DATA, BUSY = 0x0601_0000, 0x0800_0000, 0x0800_0024, 0x0800_0022
# Codes of stacks for a read of an absent object. CANopenNode answers NO_DATA to an empty history.
ABSENT = frozenset({NO_OBJECT, NO_SUB_INDEX, UNSUPPORTED, GENERAL, NO_DATA})

Place = tuple[int, int]  # index and sub-index

_ROUNDING = 10  # [ms] by which a board may round a time, at most half of it

WORDS = {
    0x0503_0000: "toggle bit not alternated",
    0x0504_0000: "SDO protocol timed out",
    0x0504_0001: "command specifier not valid",
    0x0504_0005: "out of memory",
    UNSUPPORTED: "unsupported access to an object",
    0x0601_0001: "attempt to read a write only object",
    READ_ONLY: "attempt to write a read only object",
    NO_OBJECT: "object does not exist",
    0x0604_0041: "object cannot be mapped to the PDO",
    0x0604_0042: "the mapped objects would exceed the PDO length",
    0x0604_0043: "general parameter incompatibility",
    0x0604_0047: "general internal incompatibility in the device",
    0x0606_0000: "access failed due to a hardware error",
    0x0607_0010: "length of the value does not match",
    0x0607_0012: "length of the value too high",
    0x0607_0013: "length of the value too low",
    NO_SUB_INDEX: "sub-index does not exist",
    0x0609_0030: "value out of range",
    0x0609_0031: "value too high",
    0x0609_0032: "value too low",
    0x0609_0036: "maximum is less than minimum",
    0x060A_0023: "resource not available",
    GENERAL: "general error",
    0x0800_0020: "value cannot be stored",
    0x0800_0021: "value cannot be stored because of local control",
    BUSY: "value cannot be stored in the present state of the device",
    0x0800_0023: "no object dictionary present",
    NO_DATA: "no data available",
}


def abort_words(code: int) -> str:
    """Returns an abort code in words, e.g. "object does not exist (abort 06020000h)"."""
    return f"{WORDS.get(code, 'reason unknown')} (abort {code:08X}h)"


@dataclass(frozen=True)
class Need:
    """A value that an object needs."""

    index: int
    sub: int
    value: int  # unsigned; bits outside `mask` are 0
    size: int = 1  # [bytes]
    what: str = ""  # the object in words, for messages
    mask: int = 0xFFFF_FFFF  # of the bits that matter; the others are not changed
    required: str | None = None  # why the object must exist, as a sentence; None: it may be absent
    fixed: str | None = None  # what the user must do if the value differs, as a sentence; None: the boot writes it
    rounded: bool = False  # the board may round the low 16 bits, a time in [ms]

    @property
    def at(self) -> Place:
        return self.index, self.sub

    @property
    def place(self) -> str:
        """The object for messages, e.g. "1005h sub 0 (COB-ID of SYNC)"."""
        return f"{self.index:04X}h sub {self.sub}" + (f" ({self.what})" if self.what else "")

    def words(self, value: int) -> str:
        return f"{value:0{2 * self.size}X}h"

    def met(self, present: int) -> bool:
        if not self.rounded:
            return present & self.mask == self.value & self.mask
        wanted, time = self.value & 0xFFFF, present & 0xFFFF
        off = abs(time - wanted) > min(wanted // 2, max(_ROUNDING, wanted // 8))
        return present >> 16 == self.value >> 16 and not off

    def corrected(self, present: int) -> int:
        """Returns the value to write in place of the present one."""
        return (present & ~self.mask | self.value & self.mask) & (1 << 8 * self.size) - 1


def unwatchable(board: str, index: int, sub: int, bit: int, outcome: SdoOutcome) -> ArmFault | None:
    """Returns why the answer of a watched object is not the value of an interlock, whose greatest used bit is `bit`."""
    place, needed = f"{index:04X}h sub {sub}", f"an interlock of the arm's file needs its bit {bit}"
    if outcome.silence is not None:
        return ArmFault("board-missing", board, f"board {board} does not answer to {place}: {outcome.silence}")
    if outcome.abort in ABSENT:
        return ArmFault("wrong-device", board, f"board {board} has no {place}; {needed}")
    if outcome.abort is not None:
        return ArmFault("sdo-refused", board, f"board {board} refuses to read {place}: {abort_words(outcome.abort)}")
    if bit >= 8 * len(outcome.data or b""):
        has = f"{8 * len(outcome.data or b'')} bits in {place}, counted from 0"
        return ArmFault("wrong-device", board, f"board {board} has {has}; {needed}")
    return None
