"""Compares the needs of a wiring with the electronic data sheet (EDS) of a board, without a bus (CiA 306-1)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import canopen
from canopen.objectdictionary import ODVariable

from drivers.canopen.boot import configuration
from drivers.canopen.boot.pdo_setup import ON_CHANGE, ON_SYNC, pdo_words
from drivers.canopen.layout import BoardLayout
from drivers.canopen.pdo import INPUTS, OUTPUTS, Pdo, carried_bits, subs_of
from drivers.canopen.sdo.objects import Need
from drivers.canopen.wire import cia301
from drivers.canopen.wiring import ErrorState, Timing

_PROFILE = 0x191  # CiA 401, in 1000h
_PDOS = 32  # PDOs of a direction that are searched
_MOST_ENTRIES = 8


class UnreadableEds(ValueError):
    """The file cannot be read as an EDS; the text says why."""


class Lack(NamedTuple):
    """A need of the wiring that the board does not meet, according to its EDS.

    Attributes:
        object: index and sub-index, in words.
        says: what the EDS says about this object.
        needed: what is needed, and why.
    """

    object: str
    says: str
    needed: str

    def __str__(self) -> str:
        return f"{self.object}: the EDS says {self.says}; {self.needed}"


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

    def find(self, index: int, sub: int) -> ODVariable | None:
        """Returns an entry of the dictionary; None if it is absent."""
        found = self._objects.indices.get(index)
        if found is None or isinstance(found, ODVariable):
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

    def says(self, index: int, sub: int) -> str:
        """Returns what the EDS says about an entry, in words."""
        entry, default = self.find(index, sub), self.default(index, sub)
        if entry is None:
            return "nothing of it"
        value = "" if default is None else f", DefaultValue={default:#x}"
        return f"AccessType={entry.access_type}, PDOMapping={int(bool(entry.pdo_mappable))}{value}"

    def writable(self, index: int, sub: int) -> bool:
        """Returns whether an entry exists and can be written."""
        entry = self.find(index, sub)
        return entry is not None and bool(entry.writable)


def lacks(eds: Eds, board: BoardLayout, timing: Timing, error_state: ErrorState | None) -> list[Lack]:
    """Returns all unmet needs of a board's wiring, according to its EDS.

    Args:
        eds: electronic data sheet of the board.
        board: wiring of the board.
        timing: heartbeat times.
        error_state: field `error_state` of the arm's file, for boards without an error mode.
    """
    return [
        *_identity(eds, board),
        *_bytes(eds, board.settings.object, board.output_bits, "output"),
        *_bytes(eds, INPUTS, board.input_bits, "input"),
        *_supervision(eds, board, timing),
        *_unmet(eds, configuration.synchronisation()),
        *_error_mode(eds, board, error_state),
        *_unmet(eds, configuration.interrupts(board)),
        *_pdos(eds, board, board.rpdos),
        *_pdos(eds, board, board.tpdos),
    ]


def _identity(eds: Eds, board: BoardLayout) -> Iterable[Lack]:
    kind = eds.default(0x1000, 0)
    if board.settings.object == OUTPUTS and kind is not None and kind & 0xFFFF != _PROFILE:
        yield Lack("1000h sub 0 (device type)", f"{kind:08X}h", "profile 0191h (CiA 401) is needed")
    for need in configuration.identity(board.settings):
        value = eds.default(need.index, need.sub)
        if value and not need.met(value):  # many an EDS has 0: only the device tells the value
            yield Lack(need.place, need.words(value), f"the arm's file says {need.words(need.value)}")


def _bytes(eds: Eds, index: int, bits: int, what: str) -> Iterable[Lack]:
    """Checks that the bytes of the used outputs or inputs exist and are readable."""
    for sub in subs_of(bits):
        place = f"{index:04X}h sub {sub} ({what}s {8 * sub - 8} to {8 * sub - 1})"
        entry = eds.find(index, sub)
        if entry is None:
            yield Lack(place, eds.says(index, sub), f"the wiring uses {what}s there")
        elif not entry.readable:
            yield Lack(place, eds.says(index, sub), "it must be readable, to learn where the arm is")


def _supervision(eds: Eds, board: BoardLayout, timing: Timing) -> Iterable[Lack]:
    beats, guard = list(_unmet(eds, configuration.heartbeats(timing), True)), configuration.guarding(timing)
    if beats and list(_unmet(eds, guard, True)):
        text = f"{beats[0].needed}; or node guarding by 100Ch and 100Dh, which does not suffice either"
        yield beats[0]._replace(needed=text)
    yield from _unmet(eds, [configuration.on_master_lost(board)])


def _error_mode(eds: Eds, board: BoardLayout, error_state: ErrorState | None) -> Iterable[Lack]:
    own = board.settings.object != OUTPUTS
    if not board.output_bits:
        return
    if not own:
        yield from _unmet(eds, configuration.polarity(board) + configuration.filters(board))
    if own or eds.find(0x6206, 1) is None:
        state = board.settings.error_state or error_state
        if board.loss[0] and not (state == "off" and board.loss_is_off):
            yield Lack("6206h (error mode)", eds.says(0x6206, 1), "outputs must go off when the master is lost")
        elif state is None:
            words = "set boards.error_state to off, hold or device in the arm's file, as you know the device"
            yield Lack("6206h (error mode)", eds.says(0x6206, 1), words)
        return
    yield from _unmet(eds, configuration.error_mode(board))


def _unmet(eds: Eds, needs: Iterable[Need], must: bool = False) -> Iterable[Lack]:
    """Yields the needs that the default values do not meet and that cannot be written.

    Args:
        eds: electronic data sheet of the board.
        needs: values that its objects need.
        must: absent objects count as unmet, too.
    """
    for need in needs:
        default, says = eds.default(need.index, need.sub), eds.says(need.index, need.sub)
        wanted = f"{need.words(need.value)} is needed"
        if eds.find(need.index, need.sub) is None:
            if must or need.required is not None:
                yield Lack(need.place, says, wanted + (f": {need.required}" if need.required else ""))
        elif default is not None and need.met(default):
            continue
        elif need.fixed is not None:
            if default is not None:
                yield Lack(need.place, says, f"{wanted}: {need.fixed}")
        elif not eds.writable(need.index, need.sub):
            yield Lack(need.place, says, f"it must be writable, for {wanted}")


def _pdos(eds: Eds, board: BoardLayout, wanted: Iterable[Pdo]) -> Iterable[Lack]:
    """Yields why the wanted PDOs cannot be set up."""
    taken = set[int]()
    for pdo in wanted:
        first = pdo.parameters & 0xFF00
        there = [i for i in range(first, first + _PDOS) if eds.find(i, 1) is not None and i not in taken]
        if not there:
            yield Lack(f"{first:04X}h", "no free PDO", f"{pdo_words(pdo.parameters)} is needed for the process data")
            continue
        problems = {i: list(_pdo(eds, board, pdo, i)) for i in there}
        best = min(there, key=lambda i: (len(problems[i]), i != pdo.parameters, i))
        taken.add(best)
        yield from problems[best]


def _pdo(eds: Eds, board: BoardLayout, wanted: Pdo, parameters: int) -> Iterable[Lack]:
    """Yields why one PDO cannot be set up as wanted."""
    rpdo, mapping, number = parameters < 0x1800, parameters + 0x200, pdo_words(parameters)
    base = board.settings.object if rpdo else INPUTS
    entries = [eds.default(mapping, 1 + i) or 0 for i in range(min(eds.default(mapping, 0) or 0, _MOST_ENTRIES))]
    bits = carried_bits([wanted], base) & (board.output_bits if rpdo else board.input_bits)
    if bits & ~carried_bits([wanted._replace(mapping=tuple(entries))], base) or (board.shared and rpdo):
        yield from _mapping(eds, wanted, mapping, number)
    cob_id, kind = eds.default(parameters, 1), eds.default(parameters, 2)
    same = cob_id is not None and cob_id & (cia301.INVALID | 0x7FF) == wanted.cob_id
    if not same and not eds.writable(parameters, 1):
        needed = f"{number} must be enabled with the COB-ID {wanted.cob_id:03X}h"
        yield Lack(f"{parameters:04X}h sub 1 (COB-ID)", eds.says(parameters, 1), needed)
    kinds = (*ON_SYNC, *ON_CHANGE) if rpdo else ON_CHANGE
    if kind not in kinds and not eds.writable(parameters, 2):
        needed = f"{number} needs the transmission type {kinds[0]}"
        yield Lack(f"{parameters:04X}h sub 2 (transmission type)", eds.says(parameters, 2), needed)


def _mapping(eds: Eds, wanted: Pdo, mapping: int, number: str) -> Iterable[Lack]:
    """Yields why the mapping of a PDO cannot be changed."""
    for sub in (0, *range(1, 1 + len(wanted.mapping))):
        if not eds.writable(mapping, sub):
            entries = " ".join(f"{entry:08X}h" for entry in wanted.mapping)
            needed = f"{number} does not carry what is wired, so it must be writable, for {entries}"
            yield Lack(f"{mapping:04X}h sub {sub} (mapping)", eds.says(mapping, sub), needed)
            return
    for entry in wanted.mapping:
        index, sub = entry >> 16, entry >> 8 & 0xFF
        found = eds.find(index, sub)
        if index > 7 and found is not None and not found.pdo_mappable:  # 0001h to 0007h are dummy entries
            yield Lack(f"{index:04X}h sub {sub}", eds.says(index, sub), f"{number} must map it: PDOMapping=1")
