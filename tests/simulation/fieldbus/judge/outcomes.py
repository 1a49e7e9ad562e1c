"""What a boot must make of a board as it was found: ready with warnings, or refused. By the drivers' page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from tests.simulation.fieldbus.judge.wires import INPUTS, OUTPUTS, JudgedBoard, bytes_of

OPERATIONAL, STOPPED, PRE_OPERATIONAL = 5, 4, 127
PROFILE, HAS_INPUTS, HAS_OUTPUTS = 0x191, 1 << 16, 1 << 17
MASTER = 127
Values = Mapping[tuple[int, int], int]

# Main words of the warning `board-limits`.
NO_SYNC_OBJECT = "has no 1005h"
NO_BEHAVIOUR = "has no 1029h"
NO_PROFILE = "not the profile 0191h"
NO_OUTPUT_BIT = "without the bit of digital outputs"
NO_INPUT_BIT = "without the bit of digital inputs"
NO_WAIT = "refuses to wait for SYNC"
GENERIC, COMMUNICATION = 0x01, 0x10  # bits of 1001h
MOST_ENTRIES = 8  # of 1003h
KEPT = "keeps an error from before"
DOES = {"off": "its outputs go off", "hold": "its outputs hold", "device": "its outputs do what the device is set to"}
NO_MODE, NO_MAKERS_MODE = "has no 6206h (error mode)", "has no error mode for its maker's object"
MODES = (*DOES.values(), NO_MODE, NO_MAKERS_MODE)
LIMITS = (NO_SYNC_OBJECT, NO_BEHAVIOUR, NO_PROFILE, NO_OUTPUT_BIT, NO_INPUT_BIT, NO_WAIT, KEPT, *MODES)


class Refusal(NamedTuple):
    """A fault of a boot; all words are in its sentence."""

    code: str
    words: tuple[str, ...]


class Found(NamedTuple):
    """A board when a boot begins.

    Attributes:
        state: NMT state; None: it has no supply, or is not connected.
        values: what SDO reads of all objects.
        writable: objects that SDO can write.
        deaf: indices of objects that ignore a write.
        refused: objects that refuse every SDO, and the words of the refusal.
        synchronous: whether its RPDOs may wait for SYNC.
        starts: whether it obeys the command that makes it operational.
        errors: codes of its errors, the newest first; those that report the loss of the master end by themselves.
        keeps_loss: whether also these stay.
        tells: whether it tells its NMT state, by heartbeats or on remote frames.
        explained: whether the master may have heard the emergencies of its errors.
    """

    state: int | None
    values: Values
    writable: frozenset[tuple[int, int]]
    deaf: frozenset[int]
    refused: Mapping[tuple[int, int], str]
    synchronous: bool
    starts: bool
    errors: tuple[int, ...]
    keeps_loss: bool
    tells: bool
    explained: bool = True

    def has(self, index: int, sub: int = 0) -> bool:
        return (index, sub) in self.values

    def byte(self, index: int, sub: int) -> int:
        """Returns the value of an object; 0 without it."""
        return self.values.get((index, sub), 0)


class Outcome(NamedTuple):
    """What must become of a board: refused for one of some reasons, or ready with these warnings.

    Attributes:
        refusals: reasons; empty: it must become ready.
        limits: main words of its warnings.
        outputs: what the object of its outputs must be by sub-index.
    """

    refusals: list[Refusal]
    limits: frozenset[str]
    outputs: dict[int, int]


def outcome_of(board: JudgedBoard, found: Found, needs: Values, masks: Values) -> Outcome:
    """Returns what must become of a board."""
    if found.state is None or (found.state == STOPPED and not found.tells):
        return Outcome([Refusal("board-missing", ("neither booted nor answered",))], frozenset(), {})
    refusals: list[Refusal] = []
    limits: set[str] = set()
    for reason in (_identity, _type, _supervision, _error_mode, _behaviour, _errors, _pdos):
        reason(board, found, refusals, limits)
    if not found.has(0x1005) and board.used:
        limits.add(NO_SYNC_OBJECT)
    for (index, sub), need in needs.items():
        differs = found.has(index, sub) and (found.byte(index, sub) ^ need) & masks.get((index, sub), -1)
        if differs and (index in found.deaf or (index, sub) not in found.writable):
            refusals.append(Refusal("sdo-refused", (f"{index:04X}h sub {sub}",)))
    refusals += [Refusal("sdo-refused", (f"{i:04X}h sub {sub}", words)) for (i, sub), words in found.refused.items()]
    return Outcome(refusals, frozenset(limits), settled(board, found))


def _identity(board: JudgedBoard, found: Found, refusals: list[Refusal], limits: set[str]) -> None:
    for sub, value in board.identity.items():
        if found.byte(0x1018, sub) != value:
            refusals.append(
                Refusal("wrong-device", (f"{found.byte(0x1018, sub):08X}h in 1018h sub {sub}", "another device"))
            )


def _type(board: JudgedBoard, found: Found, refusals: list[Refusal], limits: set[str]) -> None:
    kind = found.byte(0x1000, 0)
    other = board.base == OUTPUTS and kind & 0xFFFF != PROFILE
    if other:
        there = found.byte(OUTPUTS if board.used else INPUTS, 0)
        if kind & 0xFFFF in (0, 0xFFFF) and there:
            limits.add(NO_PROFILE)
        else:
            refusals.append(Refusal("wrong-device", (f"{kind:08X}h in 1000h sub 0", "0191h", "node id")))
    for bits, index, flag, limit in (
        (board.used, board.base, HAS_OUTPUTS, NO_OUTPUT_BIT),
        (board.sensed, INPUTS, HAS_INPUTS, NO_INPUT_BIT),
    ):
        if not bits:
            continue
        last = bytes_of(bits)[-1]
        if found.byte(index, 0) < last:
            refusals.append(Refusal("wrong-device", (f"{index:04X}h; sub {last} is needed", f"{kind:08X}h")))
        if kind & 0xFFFF == PROFILE and not kind & flag and index in (OUTPUTS, INPUTS):
            limits.add(limit)


def beats(found: Found) -> bool:
    """Returns whether heartbeats supervise a board; else node guarding does."""
    return found.has(0x1016, 1) and found.has(0x1017)


def _supervision(board: JudgedBoard, found: Found, refusals: list[Refusal], limits: set[str]) -> None:
    if not beats(found) and not (found.has(0x100C) and found.has(0x100D)):
        refusals.append(Refusal("wrong-device", ("neither 1016h sub 1 and 1017h", "nor 100Ch and 100Dh")))


def _error_mode(board: JudgedBoard, found: Found, refusals: list[Refusal], limits: set[str]) -> None:
    if not board.used:
        return
    state = board.error_state
    needed = bool(board.taken) and not (state == "off" and board.levels == 0)  # else they go off by themselves
    if board.base == OUTPUTS:
        for sub in bytes_of(board.used):
            wrong = found.byte(0x6202, sub) & board.used >> 8 * (sub - 1) & 0xFF
            if wrong:
                words = f"{found.byte(0x6202, sub):02X}h in 6202h sub {sub}", "polarity", "nothing can move"
                refusals.append(Refusal("wrong-device", words))
        absent = [index for index in (0x6206, 0x6207) if not found.has(index, 1)] if needed else []
        refusals += [Refusal("wrong-device", (f"has no {index:04X}h", "on_loss: contract")) for index in absent]
    if board.base == OUTPUTS and found.has(0x6206, 1):
        return
    missing = NO_MODE if board.base == OUTPUTS else NO_MAKERS_MODE
    if needed and board.base == OUTPUTS:
        return  # for the lack of 6206h or 6207h
    if needed:
        refusals.append(Refusal("wrong-device", (missing, "boards.error_state to off")))
    elif state is None:
        refusals.append(Refusal("wrong-device", (missing, "boards.error_state to off, hold or device")))
    else:
        limits.update((missing, DOES[state]))


def _behaviour(board: JudgedBoard, found: Found, refusals: list[Refusal], limits: set[str]) -> None:
    if found.has(0x1029, 1):
        return
    limits.add(NO_BEHAVIOUR)
    if board.taken and board.base == OUTPUTS and found.has(0x6206, 1):
        refusals.append(Refusal("wrong-device", ("has no 1029h sub 1", "02h is needed", "on_loss: contract")))


def _errors(board: JudgedBoard, found: Found, refusals: list[Refusal], limits: set[str]) -> None:
    lasting = [code for code in found.errors if code != 0x8130]
    history = [found.byte(0x1003, sub) & 0xFFFF for sub in range(1, 1 + found.byte(0x1003, 0))]
    if not found.starts:
        refusals.append(Refusal("board-stopped", ("did not become operational", "pre-operational", "1001h sub 0 is")))
    if lasting and not found.explained and not found.has(0x1003) and found.byte(0x1001, 0) & ~GENERIC == COMMUNICATION:
        limits.add(KEPT)  # nothing tells a new master another cause than the loss of the last one
    elif lasting:
        named = (f"({code:04X}h)" for code in lasting if code in history)
        words = ("1001h sub 0 is", "00h is needed", "1003h", *named, "Remove the cause")
        refusals.append(Refusal("board-error", words))
    elif 0x8130 in found.errors and found.keeps_loss:
        if set(history) - {0, 0x8130} or len(history) == MOST_ENTRIES:  # or one was there before the others
            refusals.append(Refusal("board-error", ("1001h sub 0 is", "1003h", "Remove the cause")))
        else:
            limits.add(KEPT)


def _pdos(board: JudgedBoard, found: Found, refusals: list[Refusal], limits: set[str]) -> None:
    if board.shares and (0x1600, 1) not in found.writable:
        refusals.append(Refusal("sdo-refused", ("shared_rpdo",)))
    if board.used and not found.synchronous and found.has(0x1005):
        limits.add(NO_WAIT)
        used = bytes_of(board.used)
        places = [{used.index(1 + bit // 8) // 8 for bit in pair} for pair in board.pairs]
        if any(len(place) > 1 for place in places):
            refusals.append(Refusal("wrong-device", ("both could be on between two frames",)))


def settled(board: JudgedBoard, found: Found) -> dict[int, int]:
    """Returns the object of the outputs before START, by sub-index."""
    outputs: dict[int, int] = {}
    for sub in range(1, 1 + found.byte(board.base, 0)):
        present = outputs[sub] = found.byte(board.base, sub)
        used = board.used >> 8 * (sub - 1) & 0xFF
        if not (present or used):
            continue
        told = board.base == OUTPUTS and found.has(0x6206, 1)
        taken = found.byte(0x6206, sub) if told else 0 if board.error_state == "hold" else 0xFF
        value = found.byte(0x6207, sub) if told else 0
        leaves = found.byte(0x1029, 1) in (0, 2)  # operational then, when it loses its master
        if found.state == OPERATIONAL and told and (leaves or found.explained):
            taken &= ~used  # the boot makes them hold before they leave operational
        unsure = taken & (value ^ present)
        known = found.state == STOPPED and told and found.has(0x6207, 1)
        level = value if known else board.off >> 8 * (sub - 1) & 0xFF
        outputs[sub] = present & ~unsure | level & unsure
    return outputs
