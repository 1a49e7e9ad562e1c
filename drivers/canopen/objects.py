"""Unsigned numbers in a board's object dictionary, read and written by SDO as parts of a procedure."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from drivers.canopen import abort_codes
from drivers.canopen.faults import Fault
from drivers.canopen.procedure import BoardError, Step
from drivers.canopen.sdo import Outcome, Transfer


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
    return entry.optional and abort in (abort_codes.NO_OBJECT, abort_codes.NO_SUB_INDEX)


def _refused(board: str, what: str, abort: int) -> BoardError:
    return BoardError(Fault("sdo-refused", board, f"board {board} refuses {what}: {abort_codes.abort_words(abort)}"))


def _silent(board: str, index: int, sub: int, outcome: Outcome) -> BoardError:
    message = f"board {board} does not answer to {index:04X}h sub {sub}: {outcome.silence}"
    return BoardError(Fault("board-missing", board, message))
