"""Layout of the process data: the bit of each line on its board, and the PDOs that carry the bits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from hyperbit.drivers.canopen.pdo import FIRST_WATCHED, INPUTS, WATCHED_BITS, Bit, Pdo, first_watched, subs_of, union
from hyperbit.drivers.canopen.status import Traffic
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import wire_bits
from hyperbit.drivers.canopen.wiring import BoardId, BoardLine, BusWiring, NodeWiring, Timing, WatchedObject, Wiring

_PDO_BYTES = 8
MOST_BYTES = 4 * _PDO_BYTES  # of one board and direction: four COB-IDs contain its node id


@dataclass(frozen=True)
class BoardLayout:
    settings: NodeWiring  # its entry in the arm's file, or defaults, with the error state of the wiring
    outputs: tuple[Bit, ...]  # lines with their bits of 6200h or of the maker's object
    inputs: tuple[Bit, ...]  # lines with their bits of 6000h and of watched objects
    watched: tuple[WatchedObject, ...]  # objects with bits of interlocks
    rpdos: tuple[Pdo, ...]
    tpdos: tuple[Pdo, ...]
    shared: bool  # other boards share its RPDO
    actuators: int  # mask of the actuators with an output or an end-stop on it
    sensed: int  # mask of its output lines whose actuators have an end-stop, on this board or another one
    pairs: tuple[tuple[int, int], ...]  # masks of the bits `output` and `output_off` of each actuator with two outputs
    loss: tuple[int, int]  # mask of the output bits with a loss level, and these levels as in 6207h

    @property
    def bus(self) -> str:
        return self.settings.bus

    @property
    def node(self) -> int:
        return self.settings.node

    @property
    def name(self) -> str:
        """Name for messages, e.g. "can0/5"."""
        return f"{self.settings.bus}/{self.settings.node}"

    @cached_property
    def output_lines(self) -> int:
        return sum(bit.line for bit in self.outputs)

    @cached_property
    def output_bits(self) -> int:
        return sum(bit.place for bit in self.outputs)

    @cached_property
    def input_lines(self) -> int:
        return sum(bit.line for bit in self.inputs)

    @cached_property
    def input_bits(self) -> int:
        """The bits of 6000h."""
        return sum(bit.place for bit in self.inputs) & (1 << FIRST_WATCHED) - 1

    def watched_bits(self, k: int) -> int:
        """Returns the used bits of the watched object k."""
        return sum(bit.place for bit in self.inputs) >> first_watched(k) & (1 << WATCHED_BITS) - 1

    def process_data(self, parameters: int) -> tuple[int, int]:
        """Returns the object that an RPDO (from 1400h) or a TPDO (from 1800h) carries, and its used bits."""
        return (INPUTS, self.input_bits) if parameters >= 0x1800 else (self.settings.object, self.output_bits)

    @property
    def loss_is_off(self) -> bool:
        """Whether each output bit with a loss level goes electrically off, as `error_state: off` ensures."""
        return self.loss[1] == 0


@dataclass(frozen=True)
class Layout:
    boards: tuple[BoardLayout, ...]  # by bus in the order of the wiring, then by node id
    board_of: tuple[int, ...]  # index of the board with the outputs of each actuator
    # indices of the boards with the end-stops of each actuator; none without end-stops
    input_boards_of: tuple[tuple[int, ...], ...]


class Unfit(ValueError):
    """A board's outputs or inputs do not fit in its PDOs. `byte` is the first that does not fit, counted from 0."""

    def __init__(self, board: BoardId, kind: str, subs: tuple[int, ...]) -> None:
        super().__init__(f"board {board}: its {kind}s are in {len(subs)} bytes; {MOST_BYTES} fit in four PDOs")
        self.board, self.kind, self.byte = board, kind, subs[MOST_BYTES] - 1


def lay_out(wiring: Wiring) -> Layout:
    """Assigns the boards' bits to PDOs. Raises Unfit if a board's outputs or inputs do not fit in four PDOs."""
    watched = _watched(wiring)
    outputs, inputs = _by_board(wiring.output_lines, {}), _by_board(wiring.input_lines, watched)
    objects = {BoardId(node.bus, node.node): node for node in wiring.nodes}
    groups = _groups({place: outputs[place] for place in wiring.boards if place in outputs}, wiring.shared_rpdo)
    actuators = _actuators(wiring)

    outputs_of = zip(wiring.channels, wiring.outputs_of, strict=True)
    sensed = sum(lines for c, lines in outputs_of if c.input is not None or c.input_contracted is not None)
    boards: list[BoardLayout] = []
    for place in wiring.boards:
        settings = objects.get(place, NodeWiring(place.bus, place.node))
        settings = replace(settings, error_state=settings.error_state or wiring.error_state)
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
                watched=tuple(watched.get(place, ())),
                rpdos=rpdos or _pdos(place, 0x1400, cia301.RPDO1, settings.object, bits),
                tpdos=_pdos(
                    place, 0x1800, cia301.TPDO1, INPUTS, tuple(b.place for b in into if not b.place >> FIRST_WATCHED)
                ),
                shared=len(group) > 1,
                actuators=actuators.get(place, 0),
                sensed=sum(bit.line for bit in out) & sensed,
                pairs=_pairs(wiring, place),
                loss=(
                    sum(bit.place for bit, _ in defined),
                    sum(bit.place for bit, level in defined if level != bit.inverted),
                ),
            )
        )
    number = {place: i for i, place in enumerate(wiring.boards)}
    ends = ([c.line("input"), c.line("input_contracted")] for c in wiring.channels)
    return Layout(
        boards=tuple(boards),
        board_of=tuple(number[BoardId(c.bus, c.node)] for c in wiring.channels),
        input_boards_of=tuple(tuple(sorted({number[end.board] for end in both if end})) for both in ends),
    )


def _actuators(wiring: Wiring) -> dict[BoardId, int]:
    """Returns the mask of the actuators with a line on each board."""
    found: dict[BoardId, int] = {}
    for k, channel in enumerate(wiring.channels):
        for line in channel.lines.values():
            found[line.board] = found.get(line.board, 0) | 1 << k
    return found


def _pairs(wiring: Wiring, place: BoardId) -> tuple[tuple[int, int], ...]:
    pairs = (wiring.channels[k] for k in wiring.paired)
    here = (c.lines for c in pairs if (c.bus, c.node) == place)
    return tuple((1 << lines["output"].bit, 1 << lines["output_off"].bit) for lines in here)


def _watched(wiring: Wiring) -> dict[BoardId, list[WatchedObject]]:
    found: dict[BoardId, dict[WatchedObject, None]] = {}
    for lock in wiring.interlocks:
        if lock.watched is not None:
            found.setdefault(lock.line.board, {})[lock.watched] = None
    return {board: list(objects) for board, objects in found.items()}


def _by_board(
    lines: Iterable[BoardLine | None], watched: Mapping[BoardId, list[WatchedObject]]
) -> dict[BoardId, list[Bit]]:
    found: dict[BoardId, list[Bit]] = {}
    for k, line in enumerate(lines):
        if line is None:
            continue
        first = 0
        if line.watched is not None:
            first = first_watched(watched[line.board].index(line.watched))
        found.setdefault(line.board, []).append(Bit(1 << k, 1 << first + line.bit, line.inverted))
    return found


def _pdos(place: BoardId, parameters: int, cob_id: int, index: int, bits: tuple[int, ...]) -> tuple[Pdo, ...]:
    subs = subs_of(union(bits))
    if len(subs) > MOST_BYTES:
        raise Unfit(place, "output" if parameters == 0x1400 else "input", subs)
    return tuple(
        Pdo(
            parameters + i,
            cob_id + 0x100 * i + place.node,
            tuple(cia301.mapping(index, sub) for sub in subs[_PDO_BYTES * i : _PDO_BYTES * (i + 1)]),
        )
        for i in range((len(subs) + _PDO_BYTES - 1) // _PDO_BYTES)
    )


def _shared(group: list[BoardId], place: BoardId, outputs: Mapping[BoardId, list[Bit]], index: int) -> tuple[Pdo, ...]:
    """Returns the RPDO of a board that shares its frame with other boards."""
    mapping: list[int] = []
    for other in group:
        subs = subs_of(union(bit.place for bit in outputs[other]))
        mapping += [cia301.mapping(index, sub) if other == place else cia301.DUMMY_BYTE for sub in subs]
    return (Pdo(0x1400, cia301.RPDO1 + group[0].node, tuple(mapping)),)


def _groups(outputs: Mapping[BoardId, list[Bit]], shared: bool) -> dict[BoardId, list[BoardId]]:
    """Returns the boards that share a frame with each board: on one bus only, and no board in two frames."""
    groups: list[list[BoardId]] = []
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


def worst_case(layout: Layout, timing: Timing, bus: BusWiring) -> Traffic:
    """Returns the greatest traffic of boards and master on a bus without faults.

    Each frame has the greatest number of stuff bits. There is one transition in each travel time, without a pause; a
    travel time below 1 ms counts as 1 ms. Each transition sends all RPDOs and switches all actuators; each end-stop
    causes its own TPDO. SDO transfers and emergencies are not counted.
    """
    boards = [board for board in layout.boards if board.bus == bus.name]
    frames = {pdo.cob_id: pdo.size for board in boards for pdo in board.rpdos}
    commits = 1 / max(timing.travel_time, 0.001)
    heartbeats = (len(boards) + 1) * wire_bits(1) / timing.heartbeat
    rpdos = commits * sum(wire_bits(size) for size in frames.values())
    sync = commits * wire_bits(0) if frames else 0.0
    greatest = {board.name: max((pdo.size for pdo in board.tpdos), default=0) for board in boards}
    tpdos = commits * sum(board.input_bits.bit_count() * wire_bits(greatest[board.name]) for board in boards)
    return Traffic(heartbeats, sync, rpdos, tpdos, (heartbeats + sync + rpdos + tpdos) / bus.bitrate)
