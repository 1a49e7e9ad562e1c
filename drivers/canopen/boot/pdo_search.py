"""Finds the PDOs of a board for its process data, and sets them up."""

from __future__ import annotations

from collections.abc import Container, Generator, Iterable

from hyperbit.drivers.canopen.boot.inspection import Inspection, Reading, ensure
from hyperbit.drivers.canopen.boot.pdo_setup import ON_CHANGE, ON_SYNC, PdoState, pdo_words, read_pdo, set_up, usable
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import FIRST_WATCHED, INPUTS, Pdo, carried_bits
from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.sdo.client import SdoOutcome
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import BoardError, Step
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import INVALID

_MOST_PDOS = 32  # PDOs of one direction to search
_MOST_USED = 4  # PDOs of one direction
_LAST_TRIED = 8  # a board without this PDO has none after it


def read_pdos(it: Inspection, in_full: bool) -> Reading:
    """Reads the PDOs for the process data.

    `in_full`: read all entries of mappings, even if their number shows that they differ. A TPDO that carries its inputs
    and a watched object keeps its mapping.
    """
    watched = it.layout.watched
    for wanted, found in ((it.layout.rpdos, it.rpdos), (it.layout.tpdos, it.tpdos)):
        found.clear()
        taken: set[int] = set()
        for pdo in wanted:
            present = yield from _find_pdo(it, pdo, taken, in_full or bool(watched))
            if present is None:
                what = f"{pdo_words(pdo.parameters)} ({pdo.parameters:04X}h): it is needed for its process data"
                raise BoardError(ArmFault("wrong-device", it.name, f"board {it.name} has no {what}"))
            taken.add(present.parameters)
            carried = carried_bits([present.pdo], INPUTS, watched)
            if found is it.tpdos and carried >> FIRST_WATCHED and not carried_bits([pdo], INPUTS) & ~carried:
                pdo = pdo._replace(mapping=present.mapping)
            found.append((pdo._replace(parameters=present.parameters), present))
    yield from _find_bringing(it)


def _find_bringing(it: Inspection) -> Reading:
    """Searches further TPDOs that carry watched objects; they are used as they are."""
    it.bringing.clear()
    node, used = it.layout.node, [present.parameters for _, present in it.tpdos]
    identifiers = {cia301.TPDO1 + 0x100 * i + node for i in range(4)} - {wanted.cob_id for wanted, _ in it.tpdos}
    for number in range(1, 1 + _MOST_PDOS) if it.layout.watched else ():
        if (parameters := 0x17FF + number) in used:
            continue
        present = yield from read_pdo(it.name, parameters)
        if present is None:
            if number >= _LAST_TRIED:
                break
        elif (
            present.valid
            and present.pdo.cob_id in identifiers
            and present.kind in ON_CHANGE
            and carried_bits([present.pdo], INPUTS, it.layout.watched) >> FIRST_WATCHED
        ):
            it.bringing.append(present.pdo)


def cover(
    it: Inspection, pdos: list[tuple[Pdo, PdoState]]
) -> Generator[Step, SdoOutcome, tuple[list[tuple[Pdo, PdoState]], list[Need]] | None]:
    """Searches PDOs whose present mappings together carry the process data; `pdos` refuse the wanted mapping.

    Returns the PDOs to set up in their place, and needs to meet before; None if there are no such PDOs.
    """
    first = pdos[0][0].parameters & 0xFF00
    base, bits = (
        (INPUTS, it.layout.input_bits) if first == 0x1800 else (it.layout.settings.object, it.layout.output_bits)
    )
    cob_id = (cia301.RPDO1 if first == 0x1400 else cia301.TPDO1) + it.layout.node
    found, others = list[tuple[Pdo, PdoState]](), list[PdoState]()
    for number in range(1, 1 + _MOST_PDOS):
        present = yield from read_pdo(it.name, first + number - 1)
        if present is None:
            if number >= _LAST_TRIED:
                break
            continue
        carried = carried_bits([present.pdo], base) & bits
        if carried and len(found) < _MOST_USED:
            found.append((Pdo(present.parameters, cob_id + 0x100 * len(found), present.mapping), present))
            bits &= ~carried
        else:
            others.append(present)
    return None if bits else (found, _silenced(it, others, [pdo.cob_id for pdo, _ in found]))


def as_is(it: Inspection) -> bool:
    """Returns whether the present PDOs carry the process data; they may carry more."""
    if it.layout.shared:
        return all(present.fits(wanted) for wanted, present in it.rpdos + it.tpdos)
    for wanted, present in it.rpdos + it.tpdos:
        if not present.in_full or usable(it.layout, wanted, present) is not None:
            return False
        if present.parameters < 0x1800 and not present.pdo.on_sync and it.synchronous and not it.refuses_sync:
            return False
    return True


def adopt(it: Inspection) -> tuple[tuple[Pdo, ...], tuple[Pdo, ...]]:
    """Returns the present RPDOs and the used TPDOs, and warns of RPDOs that do not wait for SYNC."""
    rpdos = tuple(present.pdo for _, present in it.rpdos)
    for pdo in rpdos:
        if not pdo.on_sync and it.synchronous:
            it.warn(
                f"{pdo_words(pdo.parameters)} refuses to wait for SYNC ({pdo.parameters:04X}h sub 2): its outputs"
                " switch at once with their frame, not at the same instant as other boards"
            )
    used = [present.parameters for _, present in it.tpdos]
    further = (pdo for pdo in it.bringing if pdo.parameters not in used)
    return rpdos, (*(present.pdo for _, present in it.tpdos), *further)


def check_pairs(layout: BoardLayout, rpdos: Iterable[Pdo]) -> None:
    """Checks that the two outputs of an actuator change at one instant: in one RPDO, or with one SYNC."""
    for pair in layout.pairs:
        both = pair[0] | pair[1]
        carrying = [pdo for pdo in rpdos if carried_bits([pdo], layout.settings.object) & both]
        if len(carrying) > 1 and not all(pdo.on_sync for pdo in carrying):
            outputs = " and ".join(str(bit.bit_length() - 1) for bit in pair)
            frames = " and ".join(pdo_words(pdo.parameters) for pdo in carrying)
            text = (
                f"board {layout.name}: outputs {outputs} of one actuator are in {frames}, which do not wait for SYNC:"
                " both could be on between two frames. Wire them to outputs of one RPDO"
            )
            raise BoardError(ArmFault("wrong-device", layout.name, text))


def set_up_pdos(it: Inspection, pdos: list[tuple[Pdo, PdoState]]) -> Reading:
    """Sets up the PDOs of one direction. If they refuse, uses others with a suitable mapping."""
    for again in (False, True):
        try:
            for i, (wanted, present) in enumerate(pdos):
                if not present.fits(wanted) or (wanted.parameters < 0x1800 and not it.synchronous):
                    pdos[i] = wanted, (yield from set_up(it.layout, wanted, present, it.synchronous))
            return
        except BoardError:
            other = None
            if not again and not it.layout.shared:
                other = yield from cover(it, pdos)
            if other is None:
                raise
            pdos[:], needs = other
            it.needs += needs
            yield from ensure(it, needs)


def ask_for_sync(it: Inspection) -> Reading:
    """Writes a synchronous transmission type to RPDOs that lack nothing else; notes a refusal."""
    for i, (wanted, present) in enumerate(it.rpdos):
        if (
            it.synchronous
            and present.in_full
            and not present.pdo.on_sync
            and usable(it.layout, wanted, present) is None
        ):
            kind = ON_SYNC[0]
            abort = yield from objects.write(it.name, Need(present.parameters, 2, kind), kind)
            it.refuses_sync |= abort is not None
            if abort is None:
                it.rpdos[i] = wanted, present._replace(kind=(yield from objects.read(it.name, present.parameters, 2)))


def _find_pdo(
    it: Inspection, wanted: Pdo, taken: set[int], in_full: bool
) -> Generator[Step, SdoOutcome, PdoState | None]:
    """Searches a PDO for the bits of the wanted one.

    Returns the first PDO that carries the bits, else RPDO1 or TPDO1 if it is the wanted one, else a free one; or None.
    """
    first = wanted.parameters & 0xFF00
    base, bits = _carried_object(it, first)
    needed = carried_bits([wanted], base) & bits
    further = it.quirk.further_rpdos if first == 0x1400 else 2
    chosen, others, carries_all = None, list[PdoState](), False
    for number in range(1, 1 + _MOST_PDOS):
        parameters = first + number - 1
        if parameters in taken:
            continue
        main = parameters == wanted.parameters == first
        present = yield from read_pdo(it.name, parameters, *([len(wanted.mapping)] if main and not in_full else []))
        if present is not None and main and not present.in_full and needed & ~carried_bits([present.pdo], base):
            present = yield from read_pdo(it.name, parameters)
        if present is None:
            if number >= _LAST_TRIED:
                break
            continue
        if not carries_all and (not needed & ~carried_bits([present.pdo], base) or (main and it.layout.shared)):
            chosen, carries_all = present, True
            if present.valid and present.pdo.cob_id == wanted.cob_id:
                break  # no other PDO has its COB-ID
            continue
        others.append(present)
        if chosen is None and (main or (number >= further and not (present.entries and present.valid))):
            chosen = present
    it.needs += _silenced(it, [other for other in others if other is not chosen], [wanted.cob_id])
    return chosen


def _silenced(it: Inspection, others: Iterable[PdoState], cob_ids: Container[int]) -> list[Need]:
    """Returns needs that disable the PDOs with some COB-IDs."""
    needs = []
    for other in others:
        if other.valid and other.cob_id & 0x7FF in cob_ids:
            it.values[other.parameters, 1] = other.cob_id
            what = f"COB-ID of {pdo_words(other.parameters)}, wanted for another PDO"
            needs.append(Need(other.parameters, 1, INVALID, 4, what, mask=INVALID))
    return needs


def _carried_object(it: Inspection, first: int) -> tuple[int, int]:
    """Returns the object that RPDOs (1400h) or TPDOs (1800h) carry, and its used bits."""
    if first == 0x1800:
        return INPUTS, it.layout.input_bits
    return it.layout.settings.object, it.layout.output_bits
