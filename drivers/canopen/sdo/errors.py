"""The errors of a board as a whole: error register 1001h and error history 1003h (CiA 301, 7.5.2.2 and 7.5.2.4).

1001h tells whether an error stands, but not which. Boards have four habits of writing 1003h:

- **Starts and ends** (CANopenNode, `301/CO_Emergency.c`): each end is an entry, too, with the code 0000h. Bits 24 to 31
  are the number of the error, the same in both entries; bits 16 to 23 are 1001h at that time. Other stacks use all 16
  bits of the additional information. An end in the history, or the number 1Bh of the lost heartbeat, shows this habit.
- **Standing errors only** (Lely, `src/co/emcy.c`): the end of an error takes its entry away.
- **Starts only** (CiA 301; WAGO, VIPA, Kollmorgen): an entry stays until a reset, or until sub-index 0 is written.
- **No history.**

The second and third habit look the same: an entry without an end may have ended. If 1001h is not 0, it counts as
standing. An NMT reset of communication clears such an entry; an error that stands comes back with its emergency.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.procedure import Step
from hyperbit.drivers.canopen.wire import cia301

MASTER_LOST = 0x8130  # error code
_GENERIC, _COMMUNICATION = 0x01, 0x10  # bits of 1001h that the loss of the master sets
_HEARTBEAT_LOST = 0x1B  # CANopenNode's number of MASTER_LOST
_INFORMATIVE = (*range(0x01, 0x10), *range(0x20, 0x28))  # CANopenNode's numbers of errors that set no bit of 1001h
_NO_HISTORY = objects.ABSENT - {objects.NO_SUB_INDEX, objects.NO_DATA}  # abort codes of a board without 1003h


class Errors(NamedTuple):
    """What a board tells of its errors.

    Attributes:
        register: bits of 1001h that are a fault.
        history: entries of 1003h from sub-index 1, the newest, on; None: the board has no 1003h.
        complete: whether the history has all errors since the last reset: no entry is unread, and none was pushed out.
    """

    register: int
    history: tuple[int, ...] | None = ()
    complete: bool = True

    @property
    def ends_logged(self) -> bool:
        """Whether the history has the ends of errors, too."""
        return any((value and not value & 0xFF00) or value >> 24 == _HEARTBEAT_LOST for value in self.history or ())

    @property
    def standing(self) -> tuple[tuple[int, int], ...]:
        """The entries without an end, as (sub-index, value), the newest first."""
        started: dict[int, list[tuple[int, int]]] = {}  # by the number of the error
        ended: dict[int, int] = {}
        for sub, value in reversed(tuple(enumerate(self.history or (), 1))):
            number = value >> 24 or value >> 16
            if value & 0xFF00:
                started.setdefault(number, []).append((sub, value))
            elif number in started:
                ended[number] = ended.get(number, 0) + 1
                if ended[number] >= len(started[number]):  # before, nobody can tell which of them has ended
                    del started[number], ended[number]
        return tuple(sorted(entry for entries in started.values() for entry in entries))

    @property
    def others(self) -> tuple[tuple[int, int], ...]:
        """The standing entries that do not report the loss of the master."""
        silent = self.ends_logged
        return tuple(
            (sub, value)
            for sub, value in self.standing
            if value & 0xFFFF != MASTER_LOST and not (silent and value >> 24 in _INFORMATIVE)
        )

    def lost(self, reported: int | None) -> bool:
        """Returns whether the only error is the loss of the master; `reported`: code of the last emergency, if any.

        Without 1003h the loss of the last master is the likely cause, unless an emergency has told another one.
        """
        if self.register & ~_GENERIC != _COMMUNICATION:
            return False
        if self.history is None:
            return reported in (None, MASTER_LOST)
        return self.complete and self._has_loss and not self.others

    @property
    def open(self) -> bool:
        """Whether only a boot can tell if an error is left when the heartbeat of the master returns."""
        loss = self.register & ~_GENERIC == _COMMUNICATION and self._has_loss
        return loss and not self.lost(None) and not (self.ends_logged and self.others)

    @property
    def _has_loss(self) -> bool:
        return any(value & 0xFFFF == MASTER_LOST for _, value in self.standing)

    def words(self, reported: int | None = None) -> str:
        """Returns a sentence with 1001h, the entries of 1003h that explain it, and the last emergency if it differs."""
        text = f"error register 1001h sub 0 is {self.register:02X}h; 00h is needed"
        named = self.others or self.standing
        for sub, value in named:
            text += f"; 1003h sub {sub} is {value:08X}h, {cia301.emergency_words(value & 0xFFFF)}"
        if self.history is None:
            text += "; it has no 1003h (error history)"
        elif not self.standing and self.complete:
            text += "; no entry of 1003h (error history) stands"
        elif not self.complete:
            text += "; 1003h may not have all errors: it is full, or could not be read"
        if reported is not None and all(value & 0xFFFF != reported for _, value in named):
            text += f"; it reported {cia301.emergency_words(reported)}"
        return text


def read(it: Dictionary, ignored: int = 0) -> Generator[Step, SdoOutcome, Errors]:
    """Reads the errors of a board, and the history only if 1001h has other bits than `ignored`."""
    register = yield from read_register(it, ignored)
    return (yield from read_history(it, register)) if register else Errors(0)


def read_register(it: Dictionary, ignored: int = 0) -> Generator[Step, SdoOutcome, int]:
    return (yield from it.read(0x1001, 0, fresh=True)) & ~ignored


def read_history(it: Dictionary, register: int) -> Generator[Step, SdoOutcome, Errors]:
    """Reads the history of a board whose register was read. Refuses no board: an unread entry leaves it incomplete."""
    outcome = yield from it.transfer(Transfer(0x1003, 0, fresh=True))
    if outcome.abort in _NO_HISTORY:
        return Errors(register, None)
    if not outcome.data:
        return Errors(register, (), complete=outcome.abort in objects.ABSENT)
    history, complete, count = [], True, outcome.data[0]
    for sub in range(1, 1 + count):
        outcome = yield from it.transfer(Transfer(0x1003, sub, fresh=True))
        history.append(int.from_bytes((outcome.data or b"")[:4], "little"))
        complete &= outcome.data is not None or outcome.abort in objects.ABSENT
    if history and history[-1]:  # without a free entry, older ones may be gone
        outcome = yield from it.transfer(Transfer(0x1003, 1 + count, fresh=True))
        complete &= outcome.abort != objects.NO_SUB_INDEX
    return Errors(register, tuple(history), complete)
