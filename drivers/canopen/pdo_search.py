"""The PDOs of a board that are to carry its process data: found among those that it has, and set up."""

from __future__ import annotations

from collections.abc import Container, Generator, Iterable

from drivers.canopen import cia301, objects
from drivers.canopen.cia301 import INVALID
from drivers.canopen.faults import Fault
from drivers.canopen.inspection import Inspection, Reading, settle
from drivers.canopen.objects import Need
from drivers.canopen.pdo import INPUTS, Pdo, carried_bits
from drivers.canopen.pdo_setup import ON_SYNC, Held, pdo_words, read_pdo, set_up, usable
from drivers.canopen.procedure import BoardError, Step
from drivers.canopen.sdo import Outcome

_MOST_PDOS = 32  # that are looked through
_MOST_USED = 4  # PDOs of one direction
_LAST_TRIED = 8  # a board without this PDO has none beyond


def read_pdos(it: Inspection, in_full: bool) -> Reading:
    """Reads the PDOs that are to carry the process data.

    Args:
        it: takes what is read.
        in_full: read mappings also if their number of entries tells that they differ.
    """
    for wanted, found in ((it.layout.rpdos, it.rpdos), (it.layout.tpdos, it.tpdos)):
        found.clear()
        taken: set[int] = set()
        for pdo in wanted:
            held = yield from _find_pdo(it, pdo, taken, in_full)
            if held is None:
                what = f"{pdo_words(pdo.parameters)} ({pdo.parameters:04X}h): it is needed for its process data"
                raise BoardError(Fault("wrong-device", it.name, f"board {it.name} has no {what}"))
            taken.add(held.parameters)
            found.append((pdo._replace(parameters=held.parameters), held))


def cover(
    it: Inspection, pdos: list[tuple[Pdo, Held]]
) -> Generator[Step, Outcome, tuple[list[tuple[Pdo, Held]], list[Need]] | None]:
    """Looks for PDOs that carry the process data together, as they are mapped.

    Args:
        it: takes what is read.
        pdos: the RPDOs, or the TPDOs, which refuse to be mapped as is wanted.

    Returns:
        The PDOs to be set up instead, and needs to be met before; None if there are no such PDOs.
    """
    first = pdos[0][0].parameters & 0xFF00
    base, bits = (
        (INPUTS, it.layout.input_bits) if first == 0x1800 else (it.layout.settings.object, it.layout.output_bits)
    )
    cob_id = (cia301.RPDO1 if first == 0x1400 else cia301.TPDO1) + it.layout.node
    found, others = list[tuple[Pdo, Held]](), list[Held]()
    for number in range(1, 1 + _MOST_PDOS):
        held = yield from read_pdo(it.name, first + number - 1)
        if held is None:
            if number >= _LAST_TRIED:
                break
            continue
        carried = carried_bits([held.pdo], base) & bits
        if carried and len(found) < _MOST_USED:
            found.append((Pdo(held.parameters, cob_id + 0x100 * len(found), held.mapping), held))
            bits &= ~carried
        else:
            others.append(held)
        if not bits:
            return found, _silenced(it, others, [pdo.cob_id for pdo, _ in found])
    return None


def as_is(it: Inspection) -> bool:
    """Whether the PDOs carry the process data as they are, though they may carry more."""
    if it.layout.shared:
        return all(held.fits(wanted) for wanted, held in it.rpdos + it.tpdos)
    for wanted, held in it.rpdos + it.tpdos:
        if not held.in_full or usable(it.layout, wanted, held) is not None:
            return False
        if held.parameters < 0x1800 and not held.pdo.on_sync and it.synchronous and not it.refuses_sync:
            return False
    return True


def adopt(it: Inspection) -> tuple[tuple[Pdo, ...], tuple[Pdo, ...]]:
    """Returns RPDOs and TPDOs as they are, and warns of what is lost with them."""
    rpdos = tuple(held.pdo for _, held in it.rpdos)
    for pdo in rpdos:
        if not pdo.on_sync and it.synchronous:
            it.warn(
                f"{pdo_words(pdo.parameters)} refuses to wait for SYNC ({pdo.parameters:04X}h sub 2): its outputs"
                " switch at once with their frame, not at the same instant as other boards"
            )
    return rpdos, tuple(held.pdo for _, held in it.tpdos)


def set_up_pdos(it: Inspection, pdos: list[tuple[Pdo, Held]]) -> Reading:
    """Sets up the PDOs of one direction; if they refuse, others that carry the process data as they are mapped."""
    for again in (False, True):
        try:
            for i, (wanted, held) in enumerate(pdos):
                if not held.fits(wanted) or (wanted.parameters < 0x1800 and not it.synchronous):
                    pdos[i] = wanted, (yield from set_up(it.layout, wanted, held, it.synchronous))
            return
        except BoardError:
            other = None
            if not again and not it.layout.shared:
                other = yield from cover(it, pdos)
            if other is None:
                raise
            pdos[:], needs = other
            it.needs += needs
            yield from settle(it, needs)


def ask_for_sync(it: Inspection) -> Reading:
    """Asks for RPDOs that wait for SYNC where nothing else is wrong with them: a board that refuses is left alone."""
    for i, (wanted, held) in enumerate(it.rpdos):
        if it.synchronous and held.in_full and not held.pdo.on_sync and usable(it.layout, wanted, held) is None:
            kind = ON_SYNC[0]
            abort = yield from objects.write(it.name, Need(held.parameters, 2, kind), kind)
            it.refuses_sync |= abort is not None
            if abort is None:
                it.rpdos[i] = wanted, held._replace(kind=(yield from objects.read(it.name, held.parameters, 2)))


def _find_pdo(it: Inspection, wanted: Pdo, taken: set[int], in_full: bool) -> Generator[Step, Outcome, Held | None]:
    """Looks for the PDO that is to carry bits.

    Returns:
        The first one that carries them, else RPDO1 or TPDO1 if that is wanted, or one that is free; or None.
    """
    first = wanted.parameters & 0xFF00
    base, bits = _carried_object(it, first)
    needed = carried_bits([wanted], base) & bits
    further = it.quirk.further_rpdos if first == 0x1400 else 2
    chosen, others = None, list[Held]()
    for number in range(1, 1 + _MOST_PDOS):
        parameters = first + number - 1
        if parameters in taken:
            continue
        main = parameters == wanted.parameters == first
        held = yield from read_pdo(it.name, parameters, *([len(wanted.mapping)] if main and not in_full else []))
        if held is not None and main and not held.in_full and needed & ~carried_bits([held.pdo], base):
            held = yield from read_pdo(it.name, parameters)
        if held is None:
            if number >= _LAST_TRIED:
                break
            continue
        if not needed & ~carried_bits([held.pdo], base) or (main and it.layout.shared):
            chosen = held
            break
        others.append(held)
        if chosen is None and (main or (number >= further and not (held.entries and held.valid))):
            chosen = held
    it.needs += _silenced(it, [other for other in others if other is not chosen], [wanted.cob_id])
    return chosen


def _silenced(it: Inspection, others: Iterable[Held], cob_ids: Container[int]) -> list[Need]:
    """Returns the needs that PDOs which are enabled for one of some COB-IDs are disabled."""
    needs = []
    for other in others:
        if other.valid and other.cob_id & 0x7FF in cob_ids:
            it.held[other.parameters, 1] = other.cob_id
            what = f"COB-ID of {pdo_words(other.parameters)}, wanted for another PDO"
            needs.append(Need(other.parameters, 1, INVALID, 4, what, mask=INVALID))
    return needs


def _carried_object(it: Inspection, first: int) -> tuple[int, int]:
    """Returns the object that PDOs from an index on carry, and its used bits."""
    if first == 0x1800:
        return INPUTS, it.layout.input_bits
    return it.layout.settings.object, it.layout.output_bits
