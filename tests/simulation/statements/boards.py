"""What the arm's file says about each board, as the judge reads it. Line k is bit k of masks of lines."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import groupby
from typing import Any, NamedTuple

OUTPUTS, INPUTS = 0x6200, 0x6000
PDO_BYTES = 8
INVALID = 1 << 31


class Wire(NamedTuple):
    """A line on a board: its mask, its bit in the bytes of the board, and whether the board inverts it."""

    line: int
    bit: int
    inverted: bool


class Look(NamedTuple):
    """What the world shows of one board.

    Attributes:
        number: value of an index and sub-index; 0 without it.
        has: whether there is an index and sub-index.
        state: NMT state; None without supply.
        pins: levels of its output pins.
        inputs: levels of its inputs.
    """

    number: Callable[[int, int], int]
    has: Callable[[int, int], bool]
    state: Callable[[], int | None]
    pins: Callable[[], int]
    inputs: Callable[[], int]

    def mapping(self, pdo: int) -> list[int]:
        return [self.number(pdo + 0x200, 1 + k) for k in range(self.number(pdo + 0x200, 0))]


def bytes_of(bits: int) -> list[int]:
    """Returns the sub-indices of the bytes with a bit of a mask."""
    return [1 + k for k in range((bits.bit_length() + 7) // 8) if bits >> 8 * k & 0xFF]


def bits_in(mapping: Iterable[int], base: int) -> int:
    """Returns the mask of a board's bits in a PDO (CiA 401)."""
    found = 0
    for entry in mapping:
        index, sub, count = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        size = {base: 8, base + 0x20: 1, base + 0x100: 16, base + 0x120: 32}.get(index)
        if size == count and sub and (index == base or base in (OUTPUTS, INPUTS)):
            found |= ((1 << count) - 1) << (sub - 1) * count
    return found


def _wires(lines: Iterable[Any], place: Any) -> list[Wire]:
    here = [(k, line) for k, line in enumerate(lines) if line is not None and line.board == place]
    return [Wire(1 << k, line.bit, line.inverted) for k, line in here]


class JudgedBoard:
    """One board.

    Attributes:
        base: index of its outputs.
        used: mask of its used output bits.
        sensed: mask of its used input bits.
        off: output bits that are 1 while their line is off.
        taken: output bits with a level for the loss of the master, and `levels`, these levels.
        error_state: what the file says of a board without an error mode.
        identity: needed values of 1018h by sub-index.
        rpdos: COB-IDs of the RPDOs that it needs, and `tpdos` likewise.
        shares: whether other boards share its RPDO.
        pairs: pairs of output bits of one actuator.
        actuators: mask of the actuators with a line on it.
        unsensed: mask of its output lines whose actuators have no end-stop.
    """

    def __init__(self, wiring: Any, place: Any) -> None:
        self.name, self.bus, self.node = str(place), place.bus, place.node
        here = [node for node in wiring.nodes if (node.bus, node.node) == place]
        self.base = here[0].object if here else OUTPUTS
        self.error_state = here[0].error_state if here and here[0].error_state else wiring.error_state
        named = [(1, "vendor"), (2, "product"), (3, "revision"), (4, "serial")]
        identity = {sub: getattr(node, what) for node in here for sub, what in named}
        self.identity = {sub: value for sub, value in identity.items() if value is not None}
        self.outputs = _wires(wiring.output_lines, place)
        self.inputs = _wires(wiring.input_lines, place)
        self.used = sum(1 << wire.bit for wire in self.outputs)
        self.sensed = sum(1 << wire.bit for wire in self.inputs)
        self.off = sum(1 << wire.bit for wire in self.outputs if wire.inverted)
        self.lines = sum(wire.line for wire in self.outputs)
        self.input_lines = sum(wire.line for wire in self.inputs)
        self.taken = self.levels = 0
        for wire in self.outputs:
            level = wiring.loss_levels[wire.line.bit_length() - 1]
            if level is not None:
                self.taken |= 1 << wire.bit
                self.levels |= (level != wire.inverted) << wire.bit
        self.rpdos, self.tpdos = self._cob_ids(0x200, self.used), self._cob_ids(0x180, self.sensed)
        self.shares = False
        self.interlocked = any(lock.line.board == place for lock in wiring.interlocks)
        channels = wiring.channels
        self.pairs = [
            (c.output, c.output_off) for c in channels if c.output_off is not None and (c.bus, c.node) == place
        ]
        self.actuators = sum(
            1 << k for k, c in enumerate(channels) if any(line.board == place for line in c.lines.values())
        )
        silent = [k for k, c in enumerate(channels) if c.input is None and c.input_contracted is None]
        silent += [len(channels) + i for i, k in enumerate(wiring.paired) if k in silent]
        self.unsensed = self.lines & sum(1 << k for k in silent)

    def _cob_ids(self, first: int, bits: int) -> list[int]:
        return [first + 0x100 * i + self.node for i in range(-(-len(bytes_of(bits)) // PDO_BYTES))]

    def levels_of(self, states: int) -> int:
        """Returns the levels of its used output bits for the states of all lines."""
        return sum(1 << wire.bit for wire in self.outputs if bool(states & wire.line) != wire.inverted)

    def driven(self, pins: int) -> int:
        """Returns the mask of its output lines that are on, from the levels of its pins."""
        return sum(wire.line for wire in self.outputs if (pins >> wire.bit & 1) != wire.inverted)

    def read(self, inputs: int) -> int:
        """Returns the mask of its input lines that are 1, from the levels of its inputs."""
        return sum(wire.line for wire in self.inputs if (inputs >> wire.bit & 1) != wire.inverted)


class JudgedWiring:
    """All boards of an arm.

    Attributes:
        lines: mask of all output lines.
        pulsed: mask of the output lines of pulses.
        board_of: number of the board with the outputs of each actuator.
    """

    def __init__(self, wiring: Any) -> None:
        self.boards = {str(place): JudgedBoard(wiring, place) for place in wiring.boards}
        self.rates = {bus.name: bus.bitrate for bus in wiring.buses}
        self.lines = sum(board.lines for board in self.boards.values())
        self.actuators = (1 << len(wiring.channels)) - 1
        names = list(self.boards)
        self.board_of = tuple(names.index(f"{c.bus}/{c.node}") for c in wiring.channels)
        pulses = [k for k, c in enumerate(wiring.channels) if c.pulse is not None]
        pulses += [len(wiring.channels) + i for i, k in enumerate(wiring.paired) if k in pulses]
        self.pulsed = sum(1 << k for k in pulses)
        for _, here in groupby(self.boards.values(), lambda board: board.bus):
            if wiring.shared_rpdo:
                _share([board for board in here if board.used])


def _share(boards: list[JudgedBoard]) -> None:
    """Boards of a bus share frames of up to 8 output bytes."""
    filled, first = PDO_BYTES, boards[:1]
    for board in boards:
        size = len(bytes_of(board.used))
        if filled + size > PDO_BYTES:
            filled, first = 0, [board]
        filled += size
        board.rpdos = first[0].rpdos
        board.shares = first[0].shares = board.shares or board is not first[0]
