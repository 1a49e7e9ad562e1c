"""The PDOs of a board as its object dictionary has them (CiA 301, 7.5.2.35 to 38)."""

from __future__ import annotations

from collections.abc import Callable, Container, Generator
from typing import NamedTuple

from hyperbit.drivers.canopen.pdo import Pdo
from hyperbit.drivers.canopen.sdo.client import SdoOutcome
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.procedure import Procedure, Step
from hyperbit.drivers.canopen.wire.cia301 import INVALID

MOST_ENTRIES = 64  # of a mapping; in sub-index 0, FEh and FFh have other meanings
ON_SYNC, ON_CHANGE = (1, 0), (255, 254)  # transmission types, the wanted one first
EVENT_TIME = 1000  # [ms] after which a TPDO is sent again: a lost message is noticed
_MOST_PDOS = 32  # PDOs of one direction to search
_LAST_TRIED = 8  # a board without this PDO has none after it


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


def pdo_state(objects: Dictionary, parameters: int) -> PdoState:
    """Returns the state of a PDO that was read."""
    values, mapping = objects.values, parameters + 0x200
    entries, read = values[mapping, 0], list[int]()
    while len(read) < entries <= MOST_ENTRIES and (mapping, 1 + len(read)) in values:  # above: a multiplexed PDO
        read.append(values[mapping, 1 + len(read)])
    return PdoState(
        parameters,
        cob_id=values[parameters, 1],
        kind=values[parameters, 2],
        timer=values.get((parameters, 5)),
        inhibit=values.get((parameters, 3)),
        mapping=tuple(read),
        entries=entries,
    )


def read_pdo(
    objects: Dictionary, parameters: int, most: int = MOST_ENTRIES
) -> Generator[Step, SdoOutcome, PdoState | None]:
    """Reads a PDO, and at most `most` entries of its mapping; returns None if the board has no such PDO.

    `parameters` is the index of its communication parameters. Raises BoardError if the board does not answer, or not
    according to CiA 301.
    """
    if (yield from objects.find(parameters, 1, 4)) is None:
        return None
    yield from objects.read(parameters, 2)
    if parameters >= 0x1800:
        yield from objects.find(parameters, 3, 2)
    yield from objects.find(parameters, 5, 2)
    yield from read_mapping(objects, parameters, most)
    return pdo_state(objects, parameters)


def read_mapping(objects: Dictionary, parameters: int, most: int = MOST_ENTRIES) -> Procedure:
    """Reads the first entries of a mapping, and their number."""
    entries = yield from objects.read(parameters + 0x200, 0, fresh=True)
    if entries <= MOST_ENTRIES:
        yield from read_entries(objects, parameters, range(1, 1 + min(entries, most)))


def read_entries(objects: Dictionary, parameters: int, subs: range) -> Procedure:
    for sub in subs:
        yield from objects.read(parameters + 0x200, sub, 4, fresh=True)


def read_pdos(
    objects: Dictionary, first: int, skip: Container[int], enough: Callable[[PdoState], bool] = lambda present: False
) -> Generator[Step, SdoOutcome, list[PdoState]]:
    """Reads the PDOs from `first`, 1400h or 1800h, without those to `skip`, up to the first one that is enough."""
    found = list[PdoState]()
    for parameters in range(first, first + _MOST_PDOS):
        if parameters in skip:
            continue
        present = yield from read_pdo(objects, parameters)
        if present is None and parameters >= first + _LAST_TRIED - 1:
            break
        if present is not None:
            found.append(present)
            if enough(present):
                break
    return found


def pdo_words(parameters: int) -> str:
    """Returns the name of a PDO, e.g. "RPDO1"."""
    return f"RPDO{parameters - 0x13FF}" if parameters < 0x1800 else f"TPDO{parameters - 0x17FF}"
