"""What the judge and the faults see of the boards of an arm, as plain data."""

from __future__ import annotations

from collections.abc import Mapping

from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from hyperbit.drivers.simulation.variants import Variant
from tests.simulation.buses.boards import AttachedBoards
from tests.simulation.fieldbus.judge.needs import needs_of
from tests.simulation.fieldbus.judge.outcomes import PRE_OPERATIONAL, Found
from tests.simulation.fieldbus.judge.watching import Watching
from tests.simulation.fieldbus.judge.wires import JudgedWiring, Look

REFUSALS = {0x0606_0000: "hardware error"}  # words of abort codes; other ones are for a moment
PDO_ID = 1 << 31 | 0x7FF  # bits of a PDO's COB-ID that matter
Bits = tuple[int, int, int]  # index, sub-index, and mask of some bits


class Sight:
    """The boards of an arm.

    Attributes:
        watching: knows which objects a master reads in turn, and how long a turn takes.
    """

    def __init__(self, wiring: Wiring, timing: Timing, boards: AttachedBoards, variants: Mapping[str, Variant]) -> None:
        self._boards = boards.simulated
        self.wiring = JudgedWiring(wiring, timing)
        self.looks = {name: look_at(self._boards.board(name)) for name in self.wiring.boards}
        self.watching = Watching(self.wiring, self.looks)
        self.watching.standing = frozenset(name for name, variant in variants.items() if variant.keeps_loss)
        self.watching.slow = frozenset(name for name, variant in variants.items() if variant.answer_delay)
        self.watching.slack = 8 * max((variant.answer_delay for variant in variants.values()), default=0.0)

    def found(self, name: str, explained: bool = True) -> Found:
        """Returns what SDO would read of a board, and how it behaves; for `explained` see `Found`."""
        board = self._boards.board(name)
        objects, variant, values, writable = board.objects, board.variant, {}, set()
        for index, entries in objects.described.items():
            for sub, entry in entries.items():
                if entry.size <= 4:
                    shown = objects.shown.get((index, sub))
                    values[index, sub] = shown() if shown else objects.number(index, sub)
                if entry.writable:
                    writable.add((index, sub))
        errors = tuple(reversed(board.emergencies.present))
        return Found(
            state=_state(board),
            values=values,
            writable=frozenset(writable),
            deaf=objects.variant.deaf,
            refused={place: REFUSALS[code] for place, code in objects.refused.items() if code in REFUSALS},
            synchronous=objects.variant.synchronous,
            starts=variant.starts or not any(code != 0x8130 or variant.keeps_loss for code in errors),
            errors=errors,
            keeps_loss=variant.keeps_loss,
            tells=bool(objects.number(0x1017) or objects.has(0x100C)),
            explained=explained,
        )

    def turn(self, name: str) -> float:
        """Returns the time in which all objects of the boards on the bus of a board are read once [s]."""
        bus = self.wiring.boards[name].bus
        here = {other: self.found(other) for other, board in self.wiring.boards.items() if board.bus == bus}
        return self.watching.turn(bus, here) + 60 * self._boards.board(name).variant.answer_delay

    def needed(self, name: str) -> list[Bits]:
        """Returns the objects that must be as a boot leaves them, with the bits that matter, but heartbeat times."""
        found, board = self.found(name), self.wiring.boards[name]
        objects, (_, masks) = self._boards.board(name).objects, needs_of(board, found)
        chosen = []
        for index, sub in sorted(self.watching.watched(board, found)):
            bits = masks.get((index, sub), (1 << 8 * objects.find(index, sub).size) - 1)
            if index in (0x1016, 0x100C):
                bits = 0xF000  # boards round times
            elif index & 0x1F00 in (0x1400, 0x1800) and sub == 1:
                bits &= PDO_ID
            if index != 0x1017:  # its heartbeats would be missing first
                chosen.append((index, sub, bits))
        return chosen

    def unused(self, name: str) -> list[Bits]:
        """Returns the bits of outputs and inputs in objects of settings that the wiring does not use."""
        objects, (_, masks) = self._boards.board(name).objects, needs_of(self.wiring.boards[name], self.found(name))
        settings = [place for place in masks if place[0] in (0x6206, 0x6208, 0x6006) and objects.has(place[0])]
        return [(*place, ~masks[place] & 0xFF) for place in settings if ~masks[place] & 0xFF]


def look_at(board: SimulatedBoard) -> Look:
    objects = board.objects

    def number(index: int, sub: int) -> int:
        return objects.number(index, sub) if sub in objects.described.get(index, {}) else 0

    return Look(
        number,
        objects.has,
        lambda: None if board.state is None else int(board.state),
        lambda: board.pins,
        lambda: board.inputs,
    )


def _state(board: SimulatedBoard) -> int | None:
    if board.silent or not board.powered:
        return None
    return PRE_OPERATIONAL if board.state is None else int(board.state)  # it boots in a moment
