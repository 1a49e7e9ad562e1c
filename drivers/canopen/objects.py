"""Unsigned numbers in a board's object dictionary, read and written by SDO as parts of a procedure."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from drivers.canopen.faults import Fault
from drivers.canopen.procedure import BoardError, Step
from drivers.canopen.sdo import Outcome, Transfer

# SDO abort codes (CiA 301, 7.2.4.3.17).
NO_OBJECT, NO_SUB_INDEX = 0x0602_0000, 0x0609_0011

_WORDS = {
    0x0503_0000: "toggle bit not alternated",
    0x0504_0000: "SDO protocol timed out",
    0x0504_0001: "command specifier not valid",
    0x0504_0005: "out of memory",
    0x0601_0000: "unsupported access to an object",
    0x0601_0001: "attempt to read a write only object",
    0x0601_0002: "attempt to write a read only object",
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
    0x0800_0000: "general error",
    0x0800_0020: "value cannot be stored",
    0x0800_0021: "value cannot be stored because of local control",
    0x0800_0022: "value cannot be stored in the present state of the device",
    0x0800_0023: "no object dictionary present",
    0x0800_0024: "no data available",
}


def abort_words(code: int) -> str:
    """An abort code in words, e.g. "object does not exist (abort 06020000h)"."""
    return f"{_WORDS.get(code, 'reason unknown')} (abort {code:08X}h)"


@dataclass(frozen=True)
class Entry:
    """A value of one object.

    Attributes:
        index: of the object.
        sub: sub-index.
        value: unsigned.
        size: [bytes].
        optional: CiA 301 or 401 allows boards without this object.
    """

    index: int
    sub: int
    value: int
    size: int = 1
    optional: bool = False


def read(board: str, index: int, sub: int, size: int = 1) -> Generator[Step, Outcome, int]:
    """Reads an unsigned value of `size` bytes; `board` is its name for messages.

    Raises:
        BoardError: the board refuses, does not answer, or answers in another size.
    """
    outcome = yield Transfer(index, sub)
    return number(board, index, sub, size, outcome)


def number(board: str, index: int, sub: int, size: int, outcome: Outcome) -> int:
    """Returns the value that a transfer has read.

    Raises:
        BoardError: the board refused, did not answer, or answered in another size.
    """
    if outcome.abort is not None:
        raise _refused(board, f"to read {index:04X}h sub {sub}", outcome.abort)
    if outcome.data is None:
        raise _silent(board, index, sub, outcome)
    if len(outcome.data) not in (size, 4):  # some boards send four bytes for any number
        text = f"board {board} answers {len(outcome.data)} bytes to {index:04X}h sub {sub}; {size} are needed"
        raise BoardError(Fault("wrong-device", board, text))
    return int.from_bytes(outcome.data[:size], "little")


def write(board: str, entry: Entry) -> Generator[Step, Outcome, None]:
    """Writes a value; an optional object that is absent is skipped.

    Raises:
        BoardError: the board refuses or does not answer.
    """
    outcome = yield Transfer(entry.index, entry.sub, entry.value.to_bytes(entry.size, "little"))
    if outcome.abort is not None:
        if not _absent(entry, outcome.abort):
            value = f"{entry.value:0{2 * entry.size}X}h"
            raise _refused(board, f"{value} in {entry.index:04X}h sub {entry.sub}", outcome.abort)
    elif outcome.data is None:
        raise _silent(board, entry.index, entry.sub, outcome)


def holds(board: str, entry: Entry) -> Generator[Step, Outcome, bool]:
    """Returns whether the board has this value; an optional object that is absent counts as right.

    Raises:
        BoardError: the board does not answer, or answers in another size.
    """
    outcome = yield Transfer(entry.index, entry.sub)
    if outcome.abort is not None:
        return _absent(entry, outcome.abort)
    return number(board, entry.index, entry.sub, entry.size, outcome) == entry.value


def _absent(entry: Entry, abort: int) -> bool:
    return entry.optional and abort in (NO_OBJECT, NO_SUB_INDEX)


def _refused(board: str, what: str, abort: int) -> BoardError:
    return BoardError(Fault("sdo-refused", board, f"board {board} refuses {what}: {abort_words(abort)}"))


def _silent(board: str, index: int, sub: int, outcome: Outcome) -> BoardError:
    message = f"board {board} does not answer to {index:04X}h sub {sub}: {outcome.silence}"
    return BoardError(Fault("board-missing", board, message))
