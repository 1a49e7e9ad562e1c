"""Compares the needs of a wiring with the EDS of a board, without a bus: the boot's own steps run against the EDS."""

from __future__ import annotations

from typing import NamedTuple

from hyperbit.drivers.canopen.boot import configuration, inspection, pdo_search
from hyperbit.drivers.canopen.boot.inspection import Inspection
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import INPUTS, subs_of
from hyperbit.drivers.canopen.sdo import errors, objects
from hyperbit.drivers.canopen.sdo.client import SdoOutcome
from hyperbit.drivers.canopen.sdo.procedure import BoardError, Procedure
from hyperbit.drivers.canopen.tools.eds import Eds, is_mapping
from hyperbit.drivers.canopen.tools.eds_board import EdsBoard, EdsTransfer
from hyperbit.drivers.canopen.wiring import ErrorState, Timing

_MOST_LACKS = 64
_MOST_ENTRIES = 64  # of a mapping
_PDO_PARAMETERS = (*range(0x1400, 0x1600), *range(0x1800, 0x1A00))


class Lack(NamedTuple):
    """A need of the wiring that the EDS does not meet."""

    object: str  # index and sub-index
    says: str  # about this object in the EDS
    needed: str  # why the boot refuses the board
    told: bool  # False: modules bring the object, or its value or access is missing in the EDS

    def __str__(self) -> str:
        return f"{self.object}: the EDS says {self.says}; {self.needed}"


def lacks(eds: Eds, board: BoardLayout, timing: Timing, error_state: ErrorState | None) -> list[Lack]:
    """Returns the needs of a board's wiring that contradict its EDS; see `unmet`."""
    return [lack for lack in unmet(eds, board, timing, error_state) if lack.told]


def unmet(eds: Eds, board: BoardLayout, timing: Timing, error_state: ErrorState | None) -> list[Lack]:
    """Returns all needs of a board's wiring that its EDS does not meet, or does not mention.

    The boot refuses a board at the first unmet need. This need is noted and then taken as met: an absent object as
    present, a refusing one as writable, and a wrong value as right. The boot is tried again until it succeeds.
    `error_state` is that of the arm's file, for boards without an error mode.
    """
    found: dict[str, Lack] = {}
    assumed = _identity(eds, board)
    absent: set[int] = set()
    writable: set[tuple[int, int]] = set()
    for _ in range(_MOST_LACKS):
        made = EdsBoard(eds, assumed, absent, writable)
        if (refusal := _refusal(made, _boot(board, timing, error_state))) is None:
            break
        named = [one for one in made.asked if _named(one, refusal)]
        causes = _causes(named) or made.asked[-1:]
        found.setdefault(refusal, _lack(eds, board, causes[0], named, refusal))
        before = len(assumed) + len(absent) + len(writable)
        for cause in causes:
            _take_as_met(eds, board, cause, assumed, absent, writable)
        if len(assumed) + len(absent) + len(writable) == before:
            break
    return list(found.values())


def _boot(board: BoardLayout, timing: Timing, error_state: ErrorState | None) -> Procedure:
    """Runs the steps of the boot that depend on the object dictionary."""
    it = Inspection(board)
    kind = yield from objects.read(board.name, 0x1000, 0, 4)
    yield from inspection.inspect(it, kind, timing, error_state)
    yield from pdo_search.read_pdos(it, in_full=True)
    yield from inspection.ensure(it, it.needs)
    for pdos in (it.rpdos, it.tpdos):
        yield from pdo_search.set_up_pdos(it, pdos)
    yield from inspection.ensure(it, it.error_mode)
    yield from errors.read(board.name)
    for index, bits in ((board.settings.object, board.output_bits), (INPUTS, board.input_bits)):
        for sub in subs_of(bits):
            yield from objects.read(board.name, index, sub)


def _refusal(board: EdsBoard, procedure: Procedure) -> str | None:
    """Runs a procedure against a board in process; returns why it ended early, or None."""
    outcome: SdoOutcome | None = None
    try:
        while True:
            step = next(procedure) if outcome is None else procedure.send(outcome)
            outcome = board.answer(step)
    except StopIteration:
        return None
    except BoardError as error:
        return error.fault.message


def _identity(eds: Eds, board: BoardLayout) -> dict[tuple[int, int], int]:
    """Returns the identity of the arm's file where the EDS has 0 or nothing: only the device has it."""
    needs = configuration.identity(board.settings)
    return {(need.index, need.sub): need.value for need in needs if not eds.value(need.index, need.sub)}


def _named(asked: EdsTransfer, refusal: str) -> bool:
    index = f"{asked.index:04X}h"
    return f"{index} sub {asked.sub}" in refusal or (asked.written is None and index in refusal)


def _causes(named: list[EdsTransfer]) -> list[EdsTransfer]:
    """Returns the transfers that led to a refusal: the refused writes, else the refused reads, else the last read.

    `named`: transfers with the objects that the refusal names.
    """
    refused = [one for one in named if one.abort is not None]
    writes = [one for one in refused if one.written is not None]
    return writes or refused or named[-1:]


def _lack(eds: Eds, board: BoardLayout, cause: EdsTransfer, named: list[EdsTransfer], refusal: str) -> Lack:
    index, sub = cause.blamed
    entry = eds.find(index, sub)
    text = refusal.removeprefix(f"board {board.name}: ")
    if text.startswith(own := f"board {board.name} "):
        text = f"the board {text.removeprefix(own)}"
    # An unwritable value may be right if the EDS does not give it.
    unknown = cause.abort == objects.READ_ONLY and not all(one.told for one in named)
    told = cause.told and not unknown
    if entry is not None and (index, sub) in board.watched:  # access and data type decide, not the value
        told = entry.access is not None and entry.size > 0
    return Lack(f"{index:04X}h sub {sub}", eds.says(index, sub), text, told)


def _take_as_met(
    eds: Eds,
    board: BoardLayout,
    cause: EdsTransfer,
    assumed: dict[tuple[int, int], int],
    absent: set[int],
    writable: set[tuple[int, int]],
) -> None:
    """Changes the assumptions for the next board so that it does not refuse this transfer."""
    place = cause.blamed
    if cause.abort is None and place not in board.watched:  # a wrong value that must not be written
        right = {(need.index, need.sub): need.value for need in configuration.identity(board.settings)}
        assumed[place] = 0x000F_0191 if place == (0x1000, 0) else right.get(place, 0xFE if place[1] == 0 else 0)
    elif eds.find(place[0], 0) is None:
        absent.add(place[0])
        if place[0] in _PDO_PARAMETERS:
            absent.add(place[0] + 0x200)
    elif is_mapping(place[0]):
        writable.update((place[0], sub) for sub in range(1 + _MOST_ENTRIES))
    else:
        writable.add(place)
