"""Sets up the PDOs of a board: writes what differs, and reads it back (CiA 301, 7.5.2.35 to 38)."""

from __future__ import annotations

from collections.abc import Callable, Container, Generator

from hyperbit.drivers.canopen.boot.inspection import Inspection
from hyperbit.drivers.canopen.boot.pdo_search import Unusable, cover, usable
from hyperbit.drivers.canopen.boot.pdo_state import (
    ON_CHANGE,
    ON_SYNC,
    PdoState,
    pdo_state,
    pdo_words,
    read_mapping,
)
from hyperbit.drivers.canopen.pdo import Pdo
from hyperbit.drivers.canopen.sdo.client import SdoOutcome
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.objects import Place, abort_words
from hyperbit.drivers.canopen.sdo.procedure import Procedure, Step
from hyperbit.drivers.canopen.wire.cia301 import INVALID, NO_REMOTE

_Put = Callable[[int, int, int, int], Generator[Step, SdoOutcome, bool]]


def set_up_pdos(it: Inspection, pdos: list[Pdo]) -> Procedure:
    """Sets up the PDOs of one direction. If they refuse, uses others with a suitable mapping."""
    left, last = list(pdos), it.layout.shared
    while left:
        wanted = left[0]
        rpdo_at_once = wanted.parameters < 0x1800 and not it.synchronous
        if pdo_state(it.objects, wanted.parameters).fits(wanted) and not rpdo_at_once:
            why = None
        else:
            why = yield from _set_up(it, wanted)
        if why is None:
            del left[0]
        elif not last and (other := (yield from cover(it, pdos))) is not None:
            pdos[:], needs = other
            left, last = list(pdos), True
            it.needs += needs
            yield from it.objects.meet(needs)
        else:
            it.objects.refuse("sdo-refused", f"board {it.name}: {why.text}", *why.places)


def _set_up(it: Inspection, wanted: Pdo) -> Generator[Step, SdoOutcome, Unusable | None]:
    """Writes what differs in a PDO, which may then carry more than `wanted`; returns why it cannot be used, or None.

    The order is: disable, unmap, map, type and times, enable. A refused value stays as it was.
    """
    objects, parameters = it.objects, wanted.parameters
    present, rpdo = pdo_state(objects, parameters), wanted.parameters < 0x1800
    why: list[str] = []
    refused: list[Place] = []
    written: set[Place] = set()

    def put(index: int, sub: int, value: int, size: int) -> Generator[Step, SdoOutcome, bool]:
        """Writes a value that differs; returns whether the object has the value now."""
        if value == objects.values.get((index, sub)):
            return True
        abort = yield from objects.write(index, sub, value, size)
        written.add((index, sub))
        if abort is not None:
            refused.append((index, sub))
            why.append(f"it refuses {value:0{2 * size}X}h in {index:04X}h sub {sub}: {abort_words(abort)}")
        return abort is None

    flags, changeable = present.cob_id & NO_REMOTE, True
    if present.valid:
        changeable = yield from put(parameters, 1, present.cob_id | INVALID, 4)
    if changeable and not present.maps(wanted):
        yield from _map(wanted, present, put)
    kinds = ON_SYNC if rpdo and it.synchronous else ON_CHANGE
    accepted = present.kind in kinds or (yield from put(parameters, 2, kinds[0], 1))
    if not accepted and rpdo and present.kind not in ON_CHANGE:
        yield from put(parameters, 2, ON_CHANGE[0], 1)
    if present.inhibit:
        yield from put(parameters, 3, 0, 2)
    if present.timer is not None:
        yield from put(parameters, 5, present.wanted_timer, 2)
    if changeable and not (yield from put(parameters, 1, flags | wanted.cob_id, 4)) and present.valid:
        yield from put(parameters, 1, present.cob_id, 4)
    yield from _read_back(objects, present, written)
    now = pdo_state(objects, parameters)
    unusable = usable(it.layout, wanted, now)
    if it.layout.shared and rpdo and now.pdo._replace(on_sync=True) != wanted:
        text = f"{pdo_words(parameters)} cannot be shared with other boards as the arm's file says (shared_rpdo)"
        unusable = Unusable(text, ((parameters + 0x200, 0),))
    if unusable is None:
        return None
    words = "; ".join(why) or "it does not keep what is written"
    return Unusable(f"{unusable.text}; {words}", tuple(refused) or unusable.places)


def _read_back(objects: Dictionary, present: PdoState, written: Container[Place]) -> Procedure:
    """Reads back the written objects, also after a refusal, and mapping entries that were not read before."""
    index = present.parameters
    for sub, size in ((1, 4), (2, 1), (3, 2), (5, 2)):
        if (index, sub) in written:
            yield from objects.read(index, sub, size, fresh=True)
    if (index + 0x200, 0) in written or not present.in_full:
        yield from read_mapping(objects, index)


def _map(wanted: Pdo, present: PdoState, put: _Put) -> Procedure:
    """Writes the mapping; after a refusal the mapping gets its earlier number of entries back."""
    mapping = wanted.parameters + 0x200
    if not (yield from put(mapping, 0, 0, 1)):
        return
    done = True
    for i, entry in enumerate(wanted.mapping):
        done = done and (yield from put(mapping, 1 + i, entry, 4))
    if not done or not (yield from put(mapping, 0, len(wanted.mapping), 1)):
        yield from put(mapping, 0, present.entries, 1)
