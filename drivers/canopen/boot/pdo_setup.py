"""Sets up one PDO of a board: reads it, writes what differs, and reads it back (CiA 301, 7.5.2.35 to 38)."""

from __future__ import annotations

from collections.abc import Callable, Container, Generator
from typing import NamedTuple

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import INPUTS, Pdo, carried_bits
from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.sdo.client import SdoOutcome
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import BoardError, Step
from hyperbit.drivers.canopen.wire.cia301 import INVALID, NO_REMOTE

_MOST_ENTRIES = 64  # of a mapping; in sub-index 0, FEh and FFh have other meanings
ON_SYNC, ON_CHANGE = (1, 0), (255, 254)  # transmission types, the wanted one first
EVENT_TIME = 1000  # [ms] after which a TPDO is sent again: a lost message is noticed


_Put = Callable[[int, int, int, int, int | None], Generator[Step, SdoOutcome, bool]]


class PdoState(NamedTuple):
    """The present state of one PDO of a board."""

    parameters: int  # index of its communication parameters, from 1400h or 1800h
    cob_id: int  # with its flags, sub-index 1
    kind: int  # transmission type, sub-index 2
    timer: int | None  # sub-index 5: a deadline of an RPDO, unused, or the event time of a TPDO [ms]; None: absent
    inhibit: int | None  # time of a TPDO, sub-index 3; None: absent
    mapping: tuple[int, ...]  # entries that were read
    entries: int  # number of entries in the board

    @property
    def valid(self) -> bool:
        return not self.cob_id & INVALID

    @property
    def pdo(self) -> Pdo:
        return Pdo(self.parameters, self.cob_id & 0x1FFF_FFFF, self.mapping, self.kind <= 240)

    @property
    def in_full(self) -> bool:
        """Whether all entries of the mapping were read."""
        return len(self.mapping) == self.entries

    def maps(self, wanted: Pdo) -> bool:
        return self.in_full and self.mapping == wanted.mapping

    def fits(self, wanted: Pdo) -> bool:
        """Returns whether no value must change."""
        right = self.valid and self.cob_id & 0x3FFF_FFFF == wanted.cob_id and self.maps(wanted)
        kinds = ON_SYNC if wanted.parameters < 0x1800 else ON_CHANGE
        return right and self.kind in kinds and self.timer in (None, self.wanted_timer) and not self.inhibit

    @property
    def wanted_timer(self) -> int:
        """The needed value of sub-index 5."""
        return 0 if self.parameters < 0x1800 else EVENT_TIME


def read_pdo(board: str, parameters: int, most: int = _MOST_ENTRIES) -> Generator[Step, SdoOutcome, PdoState | None]:
    """Reads a PDO, and at most `most` entries of its mapping; returns None if the board has no such PDO.

    `parameters` is the index of its communication parameters. Raises BoardError if the board does not answer, or not
    according to CiA 301.
    """
    cob_id = yield from objects.find(board, parameters, 1, 4)
    if cob_id is None:
        return None
    kind = yield from objects.read(board, parameters, 2)
    inhibit = None
    if parameters >= 0x1800:
        inhibit = yield from objects.find(board, parameters, 3, 2)
    timer = yield from objects.find(board, parameters, 5, 2)
    mapping, entries = yield from _read_mapping(board, parameters, most)
    return PdoState(parameters, cob_id, kind, timer, inhibit, mapping, entries)


def _read_mapping(board: str, parameters: int, most: int) -> Generator[Step, SdoOutcome, tuple[tuple[int, ...], int]]:
    """Reads the first entries of a mapping, and their number."""
    entries = yield from objects.read(board, parameters + 0x200, 0, fresh=True)
    if entries > _MOST_ENTRIES:  # a multiplexed PDO
        return (), entries
    mapping: tuple[int, ...] = ()
    for sub in range(1, 1 + min(entries, most)):
        mapping += ((yield from objects.read(board, parameters + 0x200, sub, 4, fresh=True)),)
    return mapping, entries


def usable(board: BoardLayout, wanted: Pdo, present: PdoState) -> str | None:
    """Returns why the present PDO cannot be used, or None."""
    base = INPUTS if wanted.parameters >= 0x1800 else board.settings.object
    number = pdo_words(present.parameters)
    needed = carried_bits([wanted], base) & (board.input_bits if base == INPUTS else board.output_bits)
    if not present.valid:
        return f"{number} is disabled ({present.parameters:04X}h sub 1 is {present.cob_id:08X}h)"
    identifiers = [(0x180 if base == INPUTS else 0x200) + 0x100 * i + board.node for i in range(4)]
    if present.cob_id & 0x3FFF_FFFF not in (wanted.cob_id, *identifiers):
        has = f"the COB-ID {present.cob_id:08X}h in {present.parameters:04X}h sub 1"
        return f"{number} has {has}, not {wanted.cob_id:03X}h"
    if needed & ~carried_bits([present.pdo], base) or present.pdo.size > 8:
        entries = ", ".join(f"{entry:08X}h" for entry in present.mapping) or "nothing"
        wants = ", ".join(f"{entry:08X}h" for entry in wanted.mapping)
        return f"{present.parameters + 0x200:04X}h maps {entries} to {number}; {wants} is needed"
    if base == INPUTS and present.kind not in ON_CHANGE:
        return f"{number} has the transmission type {present.kind}, not 255 ({present.parameters:04X}h sub 2)"
    if base != INPUTS and present.kind not in (*ON_SYNC, *ON_CHANGE):
        return f"{number} has the transmission type {present.kind}, not 1 ({present.parameters:04X}h sub 2)"
    if base != INPUTS and present.timer:
        return f"{number} has the timer {present.timer} ms, not 0 ({present.parameters:04X}h sub 5)"
    return None


def set_up(
    board: BoardLayout, wanted: Pdo, present: PdoState, synchronous: bool
) -> Generator[Step, SdoOutcome, PdoState]:
    """Writes what differs in a PDO; returns the resulting state, which may carry more than `wanted`.

    The order is: disable, unmap, map, type and times, enable. A refused value stays as it was. `synchronous`: whether
    the board receives SYNC. Raises BoardError if the PDO cannot be used, or the board does not answer.
    """
    name, parameters = board.name, wanted.parameters
    rpdo = parameters < 0x1800
    why: list[str] = []
    written: set[tuple[int, int]] = set()

    def put(index: int, sub: int, value: int, size: int, before: int | None) -> Generator[Step, SdoOutcome, bool]:
        """Writes a value that differs; returns whether the object has the value now."""
        if value == before:
            return True
        need = Need(index, sub, value, size)
        abort = yield from objects.write(name, need, value)
        written.add((index, sub))
        if abort is not None:
            why.append(f"it refuses {need.words(value)} in {index:04X}h sub {sub}: {objects.abort_words(abort)}")
        return abort is None

    flags = present.cob_id & NO_REMOTE
    changeable = True
    if present.valid:
        changeable = yield from put(parameters, 1, present.cob_id | INVALID, 4, present.cob_id)
    if changeable and not present.maps(wanted):
        yield from _map(wanted, present, put)
    kinds = ON_SYNC if rpdo and synchronous else ON_CHANGE
    accepted = present.kind in kinds or (yield from put(parameters, 2, kinds[0], 1, present.kind))
    if not accepted and rpdo and present.kind not in ON_CHANGE:
        yield from put(parameters, 2, ON_CHANGE[0], 1, present.kind)
    yield from put(parameters, 3, 0, 2, present.inhibit or 0)
    if present.timer is not None:
        yield from put(parameters, 5, present.wanted_timer, 2, present.timer)
    if changeable:
        disabled = present.cob_id | INVALID
        if not (yield from put(parameters, 1, flags | wanted.cob_id, 4, disabled)) and present.valid:
            yield from put(parameters, 1, present.cob_id, 4, disabled)
    now = yield from _read_back(name, present, written)
    reason = usable(board, wanted, now)
    if board.shared and rpdo and now.pdo._replace(on_sync=True) != wanted:
        reason = f"{pdo_words(parameters)} cannot be shared with other boards as the arm's file says (shared_rpdo)"
    if reason is not None:
        words = "; ".join(why) or "it does not keep what is written"
        raise BoardError(ArmFault("sdo-refused", name, f"board {name}: {reason}; {words}"))
    return now


def _read_back(
    name: str, present: PdoState, written: Container[tuple[int, int]]
) -> Generator[Step, SdoOutcome, PdoState]:
    """Reads back the written objects, also after a refusal, and mapping entries that were not read before."""
    index, now = present.parameters, present
    if (index, 1) in written:
        now = now._replace(cob_id=(yield from objects.read(name, index, 1, 4, fresh=True)))
    if (index, 2) in written:
        now = now._replace(kind=(yield from objects.read(name, index, 2, fresh=True)))
    if (index, 3) in written:
        now = now._replace(inhibit=(yield from objects.read(name, index, 3, 2, fresh=True)))
    if (index, 5) in written:
        now = now._replace(timer=(yield from objects.read(name, index, 5, 2, fresh=True)))
    if (index + 0x200, 0) in written or not present.in_full:
        mapping, entries = yield from _read_mapping(name, index, _MOST_ENTRIES)
        now = now._replace(mapping=mapping, entries=entries)
    return now


def _map(wanted: Pdo, present: PdoState, put: _Put) -> Generator[Step, SdoOutcome, None]:
    """Writes the mapping; after a refusal the mapping gets its earlier number of entries back."""
    mapping = wanted.parameters + 0x200
    entries = present.mapping
    if not (yield from put(mapping, 0, 0, 1, present.entries)):
        return
    done = True
    for i, entry in enumerate(wanted.mapping):
        before = entries[i] if i < len(entries) else None
        done = done and (yield from put(mapping, 1 + i, entry, 4, before))
    if not done or not (yield from put(mapping, 0, len(wanted.mapping), 1, 0)):
        yield from put(mapping, 0, present.entries, 1, 0)


def pdo_words(parameters: int) -> str:
    """Returns the name of a PDO, e.g. "RPDO1"."""
    return f"RPDO{parameters - 0x13FF}" if parameters < 0x1800 else f"TPDO{parameters - 0x17FF}"
