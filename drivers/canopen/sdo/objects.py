"""Unsigned numbers in a board's object dictionary: read, compare and write by SDO, as steps of a procedure."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.sdo.client import TRIES, SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.procedure import Ask, BoardError, Procedure, Step, Wait

# SDO abort codes (CiA 301, 7.2.4.3.17).
NO_OBJECT, NO_SUB_INDEX, READ_ONLY = 0x0602_0000, 0x0609_0011, 0x0601_0002
UNSUPPORTED, GENERAL, NO_DATA, BUSY = 0x0601_0000, 0x0800_0000, 0x0800_0024, 0x0800_0022
# Codes of stacks for a read of an absent object. CANopenNode answers NO_DATA to an empty history.
ABSENT = frozenset({NO_OBJECT, NO_SUB_INDEX, UNSUPPORTED, GENERAL, NO_DATA})

_BUSY_PAUSE = 0.2  # [s] between two attempts
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


def read(board: str, index: int, sub: int, size: int = 1, fresh: bool = False) -> Generator[Step, SdoOutcome, int]:
    """Reads an unsigned value of `size` bytes; `board` is the name for messages.

    Raises BoardError if the board refuses, does not answer, or answers in another size.
    """
    outcome = yield from answered(board, Transfer(index, sub, fresh=fresh))
    return number(board, index, sub, size, outcome)


def find(board: str, index: int, sub: int, size: int = 1) -> Generator[Step, SdoOutcome, int | None]:
    """Reads an unsigned value like `read`; returns None if the board has no such object. Raises its errors."""
    outcome = yield from answered(board, Transfer(index, sub))
    if outcome.abort in ABSENT:
        return None
    return number(board, index, sub, size, outcome)


def answered(board: str, transfer: Transfer) -> Generator[Step, SdoOutcome, SdoOutcome]:
    """Returns the outcome of a transfer. Raises BoardError after silence.

    Some boards give no answer for an object that they lack: then 1000h, which each board has, is answered.
    """
    place = f"{transfer.index:04X}h sub {transfer.sub}"
    control = not transfer.staged and transfer.index != 0x1000  # a staged write is asked once
    for _ in range(1 + control):
        outcome = yield transfer
        if outcome.silence is None:
            return outcome
        control = control and (yield Transfer(0x1000, 0, tries=1, fresh=True)).silence is None
        if not control:
            break
    if control:
        text = f"board {board} answers to 1000h, but not to {place}: {outcome.silence}"
        advice = "does it give no answer for an object that it lacks, where CiA 301 asks for an abort?"
        raise BoardError(ArmFault("sdo-unanswered", board, f"{text}; {advice}"))
    raise BoardError(ArmFault("board-missing", board, f"board {board} does not answer to {place}: {outcome.silence}"))


def number(board: str, index: int, sub: int, size: int, outcome: SdoOutcome) -> int:
    """Returns the value of an answered transfer. Raises BoardError after a refusal or an answer of another size."""
    if outcome.abort is not None:
        text = f"board {board} refuses to read {index:04X}h sub {sub}: {abort_words(outcome.abort)}"
        raise BoardError(ArmFault("sdo-refused", board, text))
    assert outcome.data is not None
    if len(outcome.data) not in (size, 4):  # some boards send four bytes for any number
        text = f"board {board} answers {len(outcome.data)} bytes to {index:04X}h sub {sub}; {size} are needed"
        raise BoardError(ArmFault("wrong-device", board, text))
    return int.from_bytes(outcome.data[:size], "little")


def watched(board: str, index: int, sub: int, bit: int, outcome: SdoOutcome) -> int:
    """Returns the value of a watched object whose greatest used bit is `bit`.

    Raises BoardError after a refusal or silence, or if the object lacks this bit.
    """
    place, needed = f"{index:04X}h sub {sub}", f"an interlock of the arm's file needs its bit {bit}"
    if outcome.abort in ABSENT:
        raise BoardError(ArmFault("wrong-device", board, f"board {board} has no {place}; {needed}"))
    if outcome.silence is not None:
        text = f"board {board} does not answer to {place}: {outcome.silence}"
        raise BoardError(ArmFault("board-missing", board, text))
    data = outcome.data or b""
    value = number(board, index, sub, len(data), outcome)
    if bit >= 8 * len(data):
        text = f"board {board} has {8 * len(data)} bits in {place}, counted from 0; {needed}"
        raise BoardError(ArmFault("wrong-device", board, text))
    return value


def write(board: str, need: Need, value: int, staged: bool = False) -> Generator[Step, SdoOutcome, int | None]:
    """Writes a value, a staged one once; returns None or the abort code. Raises BoardError after silence."""
    data = value.to_bytes(need.size, "little")
    tries = 1 if staged else TRIES
    outcome = yield from answered(board, Transfer(need.index, need.sub, data, tries=tries, staged=staged))
    return outcome.abort


def ensure(board: str, need: Need, present: int, staged: bool = False) -> Generator[Step, SdoOutcome, None]:
    """Writes the needed value and reads it back. Raises BoardError after a refusal, silence or another value."""
    value = need.corrected(present)
    abort = yield from write(board, need, value, staged)
    if abort is not None:
        raise refused(board, need, present, abort)
    confirmed = yield from read(board, need.index, need.sub, need.size, fresh=True)
    if not need.met(confirmed):
        text = f"board {board} has {need.words(confirmed)} in {need.place} after {need.words(value)} was written"
        raise BoardError(ArmFault("sdo-refused", board, f"{text}: does another program write to it?"))


def refused(board: str, need: Need, present: int, abort: int) -> BoardError:
    text = f"board {board} has {need.words(present)} in {need.place}; {need.words(need.corrected(present))} is needed"
    return BoardError(ArmFault("sdo-refused", board, f"{text}, which it refuses: {abort_words(abort)}"))


def check(board: str, need: Need) -> Generator[Step, SdoOutcome, int | None]:
    """Reads an object; returns its value, or None if the board has no such object.

    Raises BoardError if the object is required and absent, or its value is wrong and must not be written.
    """
    present = yield from find(board, need.index, need.sub, need.size)
    if present is None and need.required is not None:
        text = f"board {board} has no {need.place}; {need.words(need.value)} is needed there: {need.required}"
        raise BoardError(ArmFault("wrong-device", board, text))
    if present is not None and need.fixed is not None and not need.met(present):
        needed = need.words(need.corrected(present))
        text = f"board {board} has {need.words(present)} in {need.place}; {needed} is needed: {need.fixed}"
        raise BoardError(ArmFault("wrong-device", board, text))
    return present


def patient(procedure: Procedure, timeout: float) -> Procedure:
    """Repeats the transfers that a board refuses for its present state, 08000022h, for up to `timeout` [s] in all.

    A write is repeated only while the object has the value that was read before it.
    """
    left, seen = timeout, dict[tuple[int, int], bytes | None]()
    outcome: SdoOutcome | None = None
    while True:
        try:
            step = next(procedure) if outcome is None else procedure.send(outcome)
        except StopIteration:
            return
        outcome = yield step
        transfer = step.transfer if isinstance(step, Ask) else step
        if not isinstance(transfer, Transfer):
            continue
        place, reads = (transfer.index, transfer.sub), transfer.data is None
        while outcome.abort == BUSY and left > 0:
            left -= _BUSY_PAUSE
            yield Wait(lambda: False, _BUSY_PAUSE)
            if not reads and place in seen and (yield Transfer(*place, fresh=True)).data != seen[place]:
                break
            outcome = yield step
        if reads:
            seen[place] = outcome.data
