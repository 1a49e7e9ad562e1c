"""What the judge and the faults see of the boards of an arm, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from hyperbit.drivers.simulation.variants import Variant
from tests.simulation.buses.boards import AttachedBoards
from tests.simulation.statements.boards import INPUTS, INVALID, JudgedBoard, JudgedWiring, Look, bits_in, bytes_of
from tests.simulation.statements.objects import ALL, MASTER, Values, heartbeats, needs_of

OPERATIONAL, STOPPED, PRE_OPERATIONAL = 5, 4, 127
REFUSED = 0x0606_0000  # abort code of an object that refuses for ever; other ones are for a moment
PDO_ID = 1 << 31 | 0x7FF  # bits of a PDO's COB-ID that matter
FRAME_BITS, SHARE, PACE = 135, 0.01, 0.05  # reads in turn: share of the bit rate, and shortest time between two [s]
INPUTS_EVERY = 1.5  # [s] between two reads of the inputs of a board with an interlock
Bits = tuple[int, int, int]  # index, sub-index, and mask of some bits


class Found(NamedTuple):
    """A board when a boot begins.

    Attributes:
        state: NMT state; None: it has no supply, or is not connected.
        values: what SDO reads of all objects.
        writable: objects that SDO can write, and that do not ignore it.
        refused: objects that refuse every SDO.
        synchronous: whether its RPDOs may wait for SYNC.
        starts: whether it obeys the command that makes it operational.
        errors: codes of its errors, the newest first; 8130h reports the loss of the master, and ends by itself.
        keeps_loss: whether also that stays.
        tells: whether it tells its NMT state, by heartbeats or on remote frames.
        explained: whether the master may have heard its emergencies, and commands to it.
    """

    state: int | None
    values: Values
    writable: frozenset[tuple[int, int]]
    refused: frozenset[tuple[int, int]]
    synchronous: bool
    starts: bool
    errors: tuple[int, ...]
    keeps_loss: bool
    tells: bool
    explained: bool

    def has(self, index: int, sub: int = 0) -> bool:
        return (index, sub) in self.values

    def byte(self, index: int, sub: int) -> int:
        """Returns the value of an object; 0 without it."""
        return self.values.get((index, sub), 0)


class Sight:
    """The boards of an arm.

    Attributes:
        slack: [s] more for reads where boards answer slowly.
    """

    def __init__(self, wiring: Wiring, timing: Timing, boards: AttachedBoards, variants: Mapping[str, Variant]) -> None:
        self._boards = boards.simulated
        self.wiring = JudgedWiring(wiring)
        self.looks = {name: look_at(self._boards.board(name)) for name in self.wiring.boards}
        self.slack = 8 * max((variant.answer_delay for variant in variants.values()), default=0.0)

    def found(self, name: str, explained: bool = True) -> Found:
        """Returns what SDO would read of a board, and how it behaves; for `explained` see `Found`."""
        board = self._boards.board(name)
        objects, variant, values, writable = board.objects, board.variant, {}, set()
        for index, entries in objects.described.items():
            for sub, entry in entries.items():
                if entry.size <= 4:
                    shown = objects.shown.get((index, sub))
                    values[index, sub] = shown() if shown else objects.number(index, sub)
                if entry.writable and index not in objects.variant.deaf:
                    writable.add((index, sub))
        errors = tuple(reversed(board.emergencies.present))
        return Found(
            state=_state(board),
            values=values,
            writable=frozenset(writable),
            refused=frozenset(place for place, code in objects.refused.items() if code == REFUSED),
            synchronous=objects.variant.synchronous,
            starts=variant.starts or not any(code != 0x8130 or variant.keeps_loss for code in errors),
            errors=errors,
            keeps_loss=variant.keeps_loss,
            tells=bool(objects.number(0x1017) or objects.has(0x100C)),
            explained=explained,
        )

    def guarded(self, name: str) -> bool:
        """Returns whether node guarding supervises a board."""
        return not heartbeats(self.looks[name].has)

    def _pace(self, bus: str) -> float:
        """Returns the time between two reads in turn on a bus [s]."""
        return max(PACE, 2 * FRAME_BITS / (SHARE * self.wiring.rates[bus]))

    def turn(self, name: str) -> float:
        """Returns the time in which all objects of the boards on the bus of a board are read once [s]."""
        bus = self.wiring.boards[name].bus
        here = [board for board in self.wiring.boards.values() if board.bus == bus]
        most = max(len(self._watched(board)) + 8 for board in here)
        slow = 10 * self.slack + 60 * self._boards.board(name).variant.answer_delay
        return 1.3 * most * len(here) * self._pace(bus) + 0.3 + slow

    def inputs_every(self, name: str) -> float:
        """Returns the longest time between two reads of the inputs of a board [s]."""
        board = self.wiring.boards[name]
        if board.interlocked:
            return INPUTS_EVERY
        others = [b for b in self.wiring.boards.values() if b.bus == board.bus and not b.interlocked]
        count = sum(len(bytes_of(other.sensed)) for other in others)
        return max(INPUTS_EVERY, count * 2 * FRAME_BITS / (SHARE * self.wiring.rates[board.bus]))

    def _watched(self, board: JudgedBoard) -> set[tuple[int, int]]:
        """Returns the objects of a board that are read in turn: all that a boot needs."""
        look = self.looks[board.name]
        places = {*needs_of(board, look.has), (0x1014, 0)}
        if heartbeats(look.has):
            entries = range(1, look.number(0x1016, 0) + 1)
            places |= {(0x1016, sub) for sub in entries if look.number(0x1016, sub) >> 16 & 0x7F == MASTER}
        else:
            places |= {(0x100C, 0), (0x100D, 0)}
        for index, base, used, ours in (
            *((index, board.base, board.used, board.rpdos) for index in range(0x1400, 0x1440)),
            *((index, INPUTS, board.sensed, board.tpdos) for index in range(0x1800, 0x1840)),
        ):
            cob_id, mapping = look.number(index, 1), look.mapping(index)
            taken = not cob_id & INVALID and (cob_id & 0x7F == board.node or cob_id & 0x7FF in ours)
            if taken and bits_in(mapping, base) & used:
                places |= {(index, 1), (index, 2)} | {(index + 0x200, sub) for sub in range(len(mapping) + 1)}
        return {place for place in places if look.has(*place)}

    def needed(self, name: str) -> list[Bits]:
        """Returns the objects that must be as a boot leaves them, with the bits that matter, but heartbeat times."""
        board, objects = self.wiring.boards[name], self._boards.board(name).objects
        needs, chosen = needs_of(board, self.looks[name].has), []
        for index, sub in sorted(self._watched(board)):
            _, bits = needs.get((index, sub), (0, ALL))
            bits &= (1 << 8 * objects.find(index, sub).size) - 1
            if index in (0x1016, 0x100C):
                bits = 0xF000  # boards round times
            elif index & 0x1F00 in (0x1400, 0x1800) and sub == 1:
                bits &= PDO_ID
            if index != 0x1017:  # its heartbeats would be missing first
                chosen.append((index, sub, bits))
        return chosen

    def unused(self, name: str) -> list[Bits]:
        """Returns the bits of outputs and inputs in objects of settings that the wiring does not use."""
        needs = needs_of(self.wiring.boards[name], self.looks[name].has)
        settings = [(place, mask) for place, (_, mask) in needs.items() if place[0] in (0x6206, 0x6208, 0x6006)]
        return [(*place, ~mask & 0xFF) for place, mask in settings if ~mask & 0xFF]


def look_at(board: SimulatedBoard) -> Look:
    objects = board.objects

    def has(index: int, sub: int) -> bool:
        return sub in objects.described.get(index, {})

    return Look(
        lambda index, sub: objects.number(index, sub) if has(index, sub) else 0,
        has,
        lambda: None if board.state is None else int(board.state),
        lambda: board.pins,
        lambda: board.inputs,
    )


def _state(board: SimulatedBoard) -> int | None:
    if board.silent or not board.powered:
        return None
    return PRE_OPERATIONAL if board.state is None else int(board.state)  # it boots in a moment
