"""Layout of the process data: the bit of each line on its board, and the PDOs that carry the bits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from drivers.canopen.pdo import INPUTS, Bit, Pdo, subs_of, union
from drivers.canopen.wire import cia301
from drivers.canopen.wiring import Line, NodeSettings, Wiring

_PDO_BYTES = 8
_MOST_PDOS = 4  # of one board and direction: four COB-IDs contain its node id


@dataclass(frozen=True)
class BoardLayout:
    """The wiring of one board.

    Attributes:
        settings: its entry in the arm's file, or defaults.
        outputs: its output lines with their bits of 6200h or of the maker's object.
        inputs: its input lines with their bits of 6000h.
        rpdos: the RPDOs that carry its outputs.
        tpdos: the TPDOs that carry its inputs.
        shared: whether other boards share its RPDO.
        actuators: mask of its actuators.
        sensed: mask of its output lines whose actuators have an end-stop.
        loss: mask of the output bits with a loss level, and these levels.
    """

    settings: NodeSettings
    outputs: tuple[Bit, ...]
    inputs: tuple[Bit, ...]
    rpdos: tuple[Pdo, ...]
    tpdos: tuple[Pdo, ...]
    shared: bool
    actuators: int
    sensed: int
    loss: tuple[int, int]

    @property
    def bus(self) -> str:
        """Name of its bus."""
        return self.settings.bus

    @property
    def node(self) -> int:
        """Node id."""
        return self.settings.node

    @property
    def name(self) -> str:
        """Name for messages, e.g. "can0/5"."""
        return f"{self.settings.bus}/{self.settings.node}"

    @property
    def output_lines(self) -> int:
        """Mask of its output lines."""
        return sum(bit.line for bit in self.outputs)

    @property
    def output_bits(self) -> int:
        """Mask of the used bits of its outputs."""
        return sum(bit.place for bit in self.outputs)

    @property
    def input_bits(self) -> int:
        """Mask of the used bits of its inputs."""
        return sum(bit.place for bit in self.inputs)


@dataclass(frozen=True)
class Layout:
    """All boards of an arm.

    Attributes:
        boards: all boards, by bus in the order of the wiring, then by node id.
        board_of: index of the board of each actuator.
    """

    boards: tuple[BoardLayout, ...]
    board_of: tuple[int, ...]


class _Place(NamedTuple):
    bus: str
    node: int


def lay_out(wiring: Wiring) -> Layout:
    """Assigns the boards' bits to PDOs.

    Raises:
        ValueError: a board's outputs or inputs do not fit in four PDOs.
    """
    order = {bus.name: i for i, bus in enumerate(wiring.buses)}
    outputs, inputs = _by_board(wiring.output_lines), _by_board(wiring.input_lines)
    places = sorted({*outputs, *inputs}, key=lambda place: (order[place.bus], place.node))
    objects = {_Place(node.bus, node.node): node for node in wiring.nodes}
    groups = _groups({place: outputs[place] for place in places if place in outputs}, wiring.shared_rpdo)

    sensed = sum(1 << k for k, c in enumerate(wiring.channels) if c.input is not None or c.input_contracted is not None)
    for i, k in enumerate(wiring.paired):
        sensed |= (sensed >> k & 1) << len(wiring.channels) + i
    boards: list[BoardLayout] = []
    for place in places:
        settings = objects.get(place, NodeSettings(place.bus, place.node))
        out, into = tuple(outputs.get(place, ())), tuple(inputs.get(place, ()))
        group = groups.get(place, [])
        rpdos = _shared(group, place, outputs, settings.object) if len(group) > 1 else None
        bits = tuple(bit.place for bit in out)
        levels = [(bit, wiring.loss_levels[bit.line.bit_length() - 1]) for bit in out]
        defined = [(bit, level) for bit, level in levels if level is not None]
        boards.append(
            BoardLayout(
                settings=settings,
                outputs=out,
                inputs=into,
                rpdos=rpdos or _pdos(place, 0x1400, cia301.RPDO1, settings.object, bits),
                tpdos=_pdos(place, 0x1800, cia301.TPDO1, INPUTS, tuple(bit.place for bit in into)),
                shared=len(group) > 1,
                actuators=sum(1 << k for k, c in enumerate(wiring.channels) if (c.bus, c.node) == place),
                sensed=sum(bit.line for bit in out) & sensed,
                loss=(
                    sum(bit.place for bit, _ in defined),
                    sum(bit.place for bit, level in defined if level != bit.inverted),
                ),
            )
        )
    number = {(board.bus, board.node): i for i, board in enumerate(boards)}
    return Layout(tuple(boards), tuple(number[c.bus, c.node] for c in wiring.channels))


def _by_board(lines: Iterable[Line | None]) -> dict[_Place, list[Bit]]:
    found: dict[_Place, list[Bit]] = {}
    for k, line in enumerate(lines):
        if line is not None:
            found.setdefault(_Place(line.bus, line.node), []).append(Bit(1 << k, 1 << line.bit, line.inverted))
    return found


def _pdos(place: _Place, parameters: int, cob_id: int, index: int, bits: tuple[int, ...]) -> tuple[Pdo, ...]:
    subs = subs_of(union(bits))
    if len(subs) > _MOST_PDOS * _PDO_BYTES:
        what = "outputs" if parameters == 0x1400 else "inputs"
        raise ValueError(f"board {place.bus}/{place.node}: its {what} are in {len(subs)} bytes; 32 fit in four PDOs")
    return tuple(
        Pdo(
            parameters + i,
            cob_id + 0x100 * i + place.node,
            tuple(cia301.mapping(index, sub) for sub in subs[_PDO_BYTES * i : _PDO_BYTES * (i + 1)]),
        )
        for i in range((len(subs) + _PDO_BYTES - 1) // _PDO_BYTES)
    )


def _shared(group: list[_Place], place: _Place, outputs: Mapping[_Place, list[Bit]], index: int) -> tuple[Pdo, ...]:
    """Returns the RPDO of a board that shares its frame with other boards."""
    mapping: list[int] = []
    for other in group:
        subs = subs_of(union(bit.place for bit in outputs[other]))
        mapping += [cia301.mapping(index, sub) if other == place else cia301.DUMMY_BYTE for sub in subs]
    return (Pdo(0x1400, cia301.RPDO1 + group[0].node, tuple(mapping)),)


def _groups(outputs: Mapping[_Place, list[Bit]], shared: bool) -> dict[_Place, list[_Place]]:
    """Returns the boards that share a frame with each board: on one bus only, and no board in two frames."""
    groups: list[list[_Place]] = []
    room = 0
    for place, bits in outputs.items():
        count = len(subs_of(union(bit.place for bit in bits)))
        last = groups[-1] if groups else []
        if shared and last and last[0].bus == place.bus and count <= room:
            last.append(place)
            room -= count
        else:
            groups.append([place])
            room = _PDO_BYTES - count
    return {place: group for group in groups for place in group}
