"""Finds the PDOs of a board for its process data."""

from __future__ import annotations

from collections.abc import Container, Generator, Iterable
from typing import NamedTuple

from hyperbit.drivers.canopen.boot.inspection import Inspection
from hyperbit.drivers.canopen.boot.pdo_state import (
    MOST_ENTRIES,
    ON_CHANGE,
    ON_SYNC,
    PdoState,
    pdo_state,
    pdo_words,
    read_entries,
    read_pdo,
    read_pdos,
)
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import FIRST_WATCHED, INPUTS, Pdo, carried_bits
from hyperbit.drivers.canopen.sdo.client import SdoOutcome
from hyperbit.drivers.canopen.sdo.objects import Need, Place
from hyperbit.drivers.canopen.sdo.procedure import Procedure, Step
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import INVALID

_MOST_USED = 4  # PDOs of one direction


class Unusable(NamedTuple):
    """Why a PDO cannot be used."""

    text: str
    places: tuple[Place, ...]  # the objects at fault


def find_pdos(it: Inspection, in_full: bool) -> Procedure:
    """Finds the PDOs for the process data.

    `in_full`: read all entries of mappings, even if their number shows that they differ. A TPDO that carries its inputs
    and a watched object keeps its mapping.
    """
    watched = it.layout.watched
    for first, all_wanted, found in ((0x1400, it.layout.rpdos, it.rpdos), (0x1800, it.layout.tpdos, it.tpdos)):
        found.clear()
        base, bits = it.layout.process_data(first)
        taken = set[int]()
        for wanted in all_wanted:
            main = wanted.parameters if wanted.parameters == first and first not in taken else None
            needed = carried_bits([wanted], base) & bits
            states = yield from _candidates(it, wanted, needed, taken, main, in_full or bool(watched))
            present = _choose(it, wanted, needed, states, main)
            if present is None:
                words = f"{pdo_words(wanted.parameters)} ({wanted.parameters:04X}h): it is needed for its process data"
                it.objects.refuse("wrong-device", f"board {it.name} has no {words}", (wanted.parameters, 1))
                continue
            others = [state for state in states if state is not present]
            it.needs += _silenced(others, [wanted.cob_id])
            taken.add(present.parameters)
            carried = carried_bits([present.pdo], INPUTS, watched)
            mapping = wanted.mapping
            if first == 0x1800 and carried >> FIRST_WATCHED and not carried_bits([wanted], INPUTS) & ~carried:
                mapping = present.mapping
            found.append(wanted._replace(parameters=present.parameters, mapping=mapping))
    yield from _find_bringing(it)


def _candidates(
    it: Inspection, wanted: Pdo, needed: int, taken: set[int], main: int | None, in_full: bool
) -> Generator[Step, SdoOutcome, list[PdoState]]:
    """Reads the PDOs that may carry bits, up to one that does so with the wanted COB-ID: no other PDO has it then."""
    base, objects = it.layout.process_data(wanted.parameters)[0], it.objects

    def exact(present: PdoState) -> bool:
        carries = not needed & ~carried_bits([present.pdo], base)
        shared = present.parameters == main and it.layout.shared
        return (carries or shared) and present.valid and present.pdo.cob_id == wanted.cob_id

    states = list[PdoState]()
    if main is not None and not in_full:
        present = yield from read_pdo(objects, main, len(wanted.mapping))
        if present is not None:
            if not present.in_full and needed & ~carried_bits([present.pdo], base):
                rest = range(1 + len(present.mapping), 1 + min(present.entries, MOST_ENTRIES))
                yield from read_entries(objects, main, rest)
                present = pdo_state(objects, main)
            states.append(present)
            if exact(present):
                return states
        taken = taken | {main}
    return states + (yield from read_pdos(objects, wanted.parameters & 0xFF00, taken, exact))


def _choose(it: Inspection, wanted: Pdo, needed: int, states: list[PdoState], main: int | None) -> PdoState | None:
    """Returns the first PDO that carries the bits, else RPDO1 or TPDO1 if it is the wanted one, else a free one."""
    first = wanted.parameters & 0xFF00
    base = it.layout.process_data(first)[0]
    further = first + (it.quirk.further_rpdos if first == 0x1400 else 2) - 1
    for present in states:
        if not needed & ~carried_bits([present.pdo], base) or (present.parameters == main and it.layout.shared):
            return present
    for present in states:
        if present.parameters == main or (present.parameters >= further and not (present.entries and present.valid)):
            return present
    return None


def _silenced(others: Iterable[PdoState], cob_ids: Container[int]) -> list[Need]:
    """Returns needs that disable the PDOs with some COB-IDs."""
    return [
        Need(
            other.parameters,
            1,
            INVALID,
            4,
            f"COB-ID of {pdo_words(other.parameters)}, wanted for another PDO",
            mask=INVALID,
        )
        for other in others
        if other.valid and other.cob_id & 0x7FF in cob_ids
    ]


def _find_bringing(it: Inspection) -> Procedure:
    """Searches further TPDOs that carry watched objects; they are used as they are."""
    it.bringing.clear()
    if not it.layout.watched:
        return
    node, used = it.layout.node, [wanted.parameters for wanted in it.tpdos]
    identifiers = {cia301.TPDO1 + 0x100 * i + node for i in range(4)} - {wanted.cob_id for wanted in it.tpdos}
    for present in (yield from read_pdos(it.objects, 0x1800, used)):
        carried = carried_bits([present.pdo], INPUTS, it.layout.watched)
        told = present.valid and present.kind in ON_CHANGE and present.pdo.cob_id in identifiers
        if told and carried >> FIRST_WATCHED:
            it.bringing.append(present.parameters)


def cover(it: Inspection, pdos: list[Pdo]) -> Generator[Step, SdoOutcome, tuple[list[Pdo], list[Need]] | None]:
    """Searches PDOs whose present mappings together carry the process data; `pdos` refuse the wanted mapping.

    Returns the PDOs to set up in their place, and needs to meet before; None if there are no such PDOs.
    """
    first = pdos[0].parameters & 0xFF00
    base, bits = it.layout.process_data(first)
    cob_id = (cia301.RPDO1 if first == 0x1400 else cia301.TPDO1) + it.layout.node
    found, others = list[Pdo](), list[PdoState]()
    for present in (yield from read_pdos(it.objects, first, ())):
        carried = carried_bits([present.pdo], base) & bits
        if carried and len(found) < _MOST_USED:
            found.append(Pdo(present.parameters, cob_id + 0x100 * len(found), present.mapping))
            bits &= ~carried
        else:
            others.append(present)
    return None if bits else (found, _silenced(others, [pdo.cob_id for pdo in found]))


def usable(board: BoardLayout, wanted: Pdo, present: PdoState) -> Unusable | None:
    """Returns why the present PDO cannot be used, or None."""
    number, index = pdo_words(present.parameters), present.parameters
    base, bits = board.process_data(index)
    needed = carried_bits([wanted], base) & bits
    identifiers = [(0x180 if base == INPUTS else 0x200) + 0x100 * i + board.node for i in range(4)]
    if not present.valid:
        return Unusable(f"{number} is disabled ({index:04X}h sub 1 is {present.cob_id:08X}h)", ((index, 1),))
    if present.cob_id & 0x3FFF_FFFF not in (wanted.cob_id, *identifiers):
        has = f"the COB-ID {present.cob_id:08X}h in {index:04X}h sub 1"
        return Unusable(f"{number} has {has}, not {wanted.cob_id:03X}h", ((index, 1),))
    if needed & ~carried_bits([present.pdo], base) or present.pdo.size > 8:
        entries = ", ".join(f"{entry:08X}h" for entry in present.mapping) or "nothing"
        wants = ", ".join(f"{entry:08X}h" for entry in wanted.mapping)
        text = f"{index + 0x200:04X}h maps {entries} to {number}; {wants} is needed"
        return Unusable(text, ((index + 0x200, 0),))
    if present.kind not in (ON_CHANGE if base == INPUTS else (*ON_SYNC, *ON_CHANGE)):
        has = f"the transmission type {present.kind}, not {255 if base == INPUTS else 1}"
        return Unusable(f"{number} has {has} ({index:04X}h sub 2)", ((index, 2),))
    if base != INPUTS and present.timer:
        return Unusable(f"{number} has the timer {present.timer} ms, not 0 ({index:04X}h sub 5)", ((index, 5),))
    return None


def ask_for_sync(it: Inspection) -> Procedure:
    """Writes a synchronous transmission type to RPDOs that lack nothing else; notes a refusal."""
    for wanted in it.rpdos if it.synchronous else ():
        present = pdo_state(it.objects, wanted.parameters)
        if present.in_full and not present.pdo.on_sync and usable(it.layout, wanted, present) is None:
            abort = yield from it.objects.write(present.parameters, 2, ON_SYNC[0], 1)
            it.refuses_sync |= abort is not None
            if abort is None:
                yield from it.objects.read(present.parameters, 2)


def as_is(it: Inspection) -> bool:
    """Returns whether the present PDOs carry the process data; they may carry more."""
    for wanted in it.rpdos + it.tpdos:
        present = pdo_state(it.objects, wanted.parameters)
        if it.layout.shared:
            if not present.fits(wanted):
                return False
            continue
        if not present.in_full or usable(it.layout, wanted, present) is not None:
            return False
        if wanted.parameters < 0x1800 and not present.pdo.on_sync and it.synchronous and not it.refuses_sync:
            return False
    return True


def adopt(it: Inspection) -> tuple[tuple[Pdo, ...], tuple[Pdo, ...]]:
    """Returns the present RPDOs and the used TPDOs, and warns of RPDOs that do not wait for SYNC."""
    used = [wanted.parameters for wanted in it.tpdos]
    used += [parameters for parameters in it.bringing if parameters not in used]
    rpdos = tuple(pdo_state(it.objects, wanted.parameters).pdo for wanted in it.rpdos)
    for pdo in rpdos:
        if not pdo.on_sync and it.synchronous:
            it.warn(
                f"{pdo_words(pdo.parameters)} refuses to wait for SYNC ({pdo.parameters:04X}h sub 2): its outputs"
                " switch at once with their frame, not at the same instant as other boards"
            )
    _check_pairs(it, rpdos)
    return rpdos, tuple(pdo_state(it.objects, parameters).pdo for parameters in used)


def _check_pairs(it: Inspection, rpdos: Iterable[Pdo]) -> None:
    """Refuses a board whose two outputs of an actuator do not change at one instant: in one RPDO, or with one SYNC."""
    for pair in it.layout.pairs:
        both = pair[0] | pair[1]
        carrying = [pdo for pdo in rpdos if carried_bits([pdo], it.layout.settings.object) & both]
        if len(carrying) > 1 and not all(pdo.on_sync for pdo in carrying):
            outputs = " and ".join(str(bit.bit_length() - 1) for bit in pair)
            frames = " and ".join(pdo_words(pdo.parameters) for pdo in carrying)
            text = (
                f"board {it.name}: outputs {outputs} of one actuator are in {frames}, which do not wait for SYNC: both"
                " could be on between two frames. Wire them to outputs of one RPDO"
            )
            it.objects.refuse("wrong-device", text, *[(pdo.parameters, 2) for pdo in carrying if not pdo.on_sync])
