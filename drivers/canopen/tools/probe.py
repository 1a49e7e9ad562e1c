"""Finds all nodes of a bus, and reads the important objects of each; writes nothing."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass, field

from hyperbit.drivers.canopen.boot.pdo_state import PdoState, read_pdo
from hyperbit.drivers.canopen.faults import ArmFault, BusError
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.objects import NO_OBJECT, NO_SUB_INDEX
from hyperbit.drivers.canopen.sdo.procedure import BoardError, Procedure, Step
from hyperbit.drivers.canopen.tools.session import Session
from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.canopen.wiring import MASTER

NODES = range(1, 128)
_FIRST, _TRIES = 0.5, 2  # [s] for the first answer of a node, and attempts
_PDOS = 32  # RPDOs and TPDOs to search
_MOST_SUBS = 32  # entries of an array to read

TEXTS = (0x1008, 0x1009, 0x100A)
_NUMBERS = {0x1001: 0, 0x1005: 0, 0x1006: 0, 0x100C: 0, 0x100D: 0, 0x1010: 1, 0x1017: 0, 0x1019: 0, 0x1029: 1}
_ARRAYS = (0x1003, 0x1016, 0x1018, 0x6202, 0x6206, 0x6207)
_COUNTS = {0x6000: 0, 0x6200: 0}  # arrays whose sub-index 0 alone is read


@dataclass
class ProbedNode:
    """One node of a bus. Its objects are by index and sub-index."""

    node: int
    state: State | None = None  # the last one; None if neither a heartbeat nor an answer to a remote frame came
    answers: bool = False  # to SDO requests
    numbers: dict[tuple[int, int], int] = field(default_factory=dict)  # unsigned
    texts: dict[int, str] = field(default_factory=dict)  # by index
    refused: dict[tuple[int, int], int] = field(default_factory=dict)  # abort codes of objects that exist
    rpdos: list[PdoState] = field(default_factory=list)
    tpdos: list[PdoState] = field(default_factory=list)
    trouble: str | None = None  # why its probe ended early, as a sentence


def probe_bus(session: Session, bus: str, nodes: Iterable[int] = NODES, *, in_full: bool = True) -> list[ProbedNode]:
    """Asks nodes of a bus in parallel; returns those that answer, or send heartbeats, by node id.

    A node that neither answers nor sends heartbeats is polled by a remote frame: it may be stopped. Without `in_full`
    only 1000h and 1018h are read. Raises MasterHeard, and BusError if the bus cannot be used.
    """
    asked = {node: ProbedNode(node) for node in nodes}
    faults = session.run({(bus, node): _ask(session, bus, it, in_full) for node, it in asked.items()})
    for node, it in asked.items():
        it.state = session.states.get((bus, node))
        if (fault := faults[bus, node]) is not None:
            it.trouble = fault.message
    found = [it for it in asked.values() if it.answers or it.state is not None]
    if not found and (trouble := session.trouble(bus)) is not None:
        raise BusError(trouble.message)
    return found


def _ask(session: Session, bus: str, it: ProbedNode, in_full: bool) -> Procedure:
    outcome = yield Transfer(0x1000, 0, timeout=_FIRST, tries=_TRIES)
    if outcome.silence is not None:
        if it.node != MASTER:
            yield from session.poll_state((bus, it.node))
        return
    it.answers = True
    _store(it, 0x1000, 0, outcome)
    yield from _array(it, 0x1018)
    if not in_full:
        return
    for index, sub in (_NUMBERS | _COUNTS).items():
        _store(it, index, sub, (yield Transfer(index, sub)))
    for index in _ARRAYS:
        yield from _array(it, index)
    for index in TEXTS:
        outcome = yield Transfer(index, 0)
        if outcome.data is not None:
            it.texts[index] = outcome.data.decode("latin-1").rstrip("\0 ")
    objects = Dictionary(str(it.node))
    for first, pdos in ((0x1400, it.rpdos), (0x1800, it.tpdos)):
        for parameters in range(first, first + _PDOS):
            if (pdo := (yield from read_pdo(objects, parameters))) is not None:
                pdos.append(pdo)


def _array(it: ProbedNode, index: int) -> Generator[Step, SdoOutcome, None]:
    if (index, 0) not in it.numbers:
        _store(it, index, 0, (yield Transfer(index, 0)))
    for sub in range(1, 1 + min(it.numbers.get((index, 0), 0), _MOST_SUBS)):
        _store(it, index, sub, (yield Transfer(index, sub)))


def _store(it: ProbedNode, index: int, sub: int, outcome: SdoOutcome) -> None:
    """Stores the value or the refusal of an object. Raises BoardError if the node does not answer any more."""
    if outcome.data is not None:
        it.numbers[index, sub] = int.from_bytes(outcome.data, "little")
    elif outcome.abort is None:
        text = f"it stopped answering at {index:04X}h sub {sub}: {outcome.silence}"
        raise BoardError(ArmFault("board-missing", str(it.node), text))
    elif outcome.abort not in (NO_OBJECT, NO_SUB_INDEX):
        it.refused[index, sub] = outcome.abort
