"""Layout of the process data: each actuator's bit in the boards' bytes, and the PDOs that carry the bytes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from drivers.canopen import cia301
from drivers.canopen.wiring import Channel, Wiring

_FRAME_BYTES = 8


class Pdo(NamedTuple):
    """One PDO as a board is configured for it.

    Attributes:
        parameters: index of its communication parameters, 1400h or 1800h; its mapping is 200h above.
        cob_id: of its frame.
        mapping: entries, dummies included.
    """

    parameters: int
    cob_id: int
    mapping: tuple[int, ...]


class Bit(NamedTuple):
    """One actuator in a number that is made of little-endian bytes."""

    actuator: int  # mask of one bit
    place: int  # mask of one bit


class Run(NamedTuple):
    """Neighbouring actuators on neighbouring bits, to copy them at once.

    Attributes:
        actuator: index of the first.
        mask: of as many bits as there are actuators, from bit 0.
        place: bit of the first.
    """

    actuator: int
    mask: int
    place: int


@dataclass(frozen=True)
class BoardLayout:
    """The wiring of one board.

    Attributes:
        bus: name of its bus.
        node: node id.
        outputs: used sub-indices of 6200h, ascending.
        inputs: used sub-indices of 6000h, ascending.
        rpdo: carries its outputs.
        tpdo: carries its inputs; None without end-stops.
        frame: index of the RPDO frame in `Layout.frames`.
        offset: of its first byte in that frame.
        actuators: mask of its actuators.
        sensed: mask of its actuators that have an end-stop.
        ends: the end-stops in the number that its input bytes make.
    """

    bus: str
    node: int
    outputs: tuple[int, ...]
    inputs: tuple[int, ...]
    rpdo: Pdo
    tpdo: Pdo | None
    frame: int
    offset: int
    actuators: int
    sensed: int
    ends: tuple[Bit, ...]

    @property
    def name(self) -> str:
        """For messages, e.g. "can0/5"."""
        return f"{self.bus}/{self.node}"


@dataclass(frozen=True)
class RpdoFrame:
    """One RPDO frame of the master; several boards may take it.

    Attributes:
        bus: name of its bus.
        cob_id: its COB-ID.
        size: [bytes].
        actuators: mask of the actuators in it.
        used: mask of the bits that are actuators', in the number that its bytes make.
        bits: the actuators in that number.
        runs: the same, in runs.
    """

    bus: str
    cob_id: int
    size: int
    actuators: int
    used: int
    bits: tuple[Bit, ...]
    runs: tuple[Run, ...]


@dataclass(frozen=True)
class Layout:
    """All boards and RPDO frames of an arm.

    Attributes:
        boards: by bus, in the order of the wiring, and node id.
        frames: likewise.
        board_of: index of each actuator's board.
    """

    boards: tuple[BoardLayout, ...]
    frames: tuple[RpdoFrame, ...]
    board_of: tuple[int, ...]


class _Place(NamedTuple):
    bus: str
    node: int


_Wired = list[tuple[int, Channel]]  # of one board: actuators with their index


def lay_out(wiring: Wiring) -> Layout:
    """Assigns the boards' bytes to frames."""
    order = {bus.name: i for i, bus in enumerate(wiring.buses)}
    wired: dict[_Place, _Wired] = {}
    for k, channel in sorted(enumerate(wiring.channels), key=lambda item: (order[item[1].bus], item[1].node)):
        wired.setdefault(_Place(channel.bus, channel.node), []).append((k, channel))
    outputs = {place: _subs(c.output for _, c in here) for place, here in wired.items()}

    boards: list[BoardLayout] = []
    frames: list[RpdoFrame] = []
    for group in _groups(outputs, wiring.shared_rpdo):
        cob_id, size = cia301.RPDO1 + group[0].node, sum(len(outputs[place]) for place in group)
        bits: list[Bit] = []
        offset = 0
        for place in group:
            here, subs = wired[place], outputs[place]
            mapping = [cia301.DUMMY_BYTE] * offset
            mapping += [cia301.mapping(0x6200, sub) for sub in subs]
            mapping += [cia301.DUMMY_BYTE] * (size - len(mapping))
            bits += [Bit(1 << k, 1 << 8 * offset << _bit(c.output, subs)) for k, c in here]
            rpdo = Pdo(0x1400, cob_id, tuple(mapping))
            boards.append(_board(place, here, subs, rpdo, len(frames), offset))
            offset += len(subs)
        actuators, used = sum(bit.actuator for bit in bits), sum(bit.place for bit in bits)
        frames.append(RpdoFrame(group[0].bus, cob_id, size, actuators, used, tuple(bits), _runs(bits)))
    number = {(board.bus, board.node): i for i, board in enumerate(boards)}
    return Layout(tuple(boards), tuple(frames), tuple(number[c.bus, c.node] for c in wiring.channels))


def _board(place: _Place, here: _Wired, outputs: tuple[int, ...], rpdo: Pdo, frame: int, offset: int) -> BoardLayout:
    inputs = _subs(c.input for _, c in here if c.input is not None)
    ends = tuple(Bit(1 << k, 1 << _bit(c.input, inputs)) for k, c in here if c.input is not None)
    mapping = tuple(cia301.mapping(0x6000, sub) for sub in inputs)
    return BoardLayout(
        bus=place.bus,
        node=place.node,
        outputs=outputs,
        inputs=inputs,
        rpdo=rpdo,
        tpdo=Pdo(0x1800, cia301.TPDO1 + place.node, mapping) if inputs else None,
        frame=frame,
        offset=offset,
        actuators=sum(1 << k for k, _ in here),
        sensed=sum(bit.actuator for bit in ends),
        ends=ends,
    )


def _runs(bits: Iterable[Bit]) -> tuple[Run, ...]:
    runs: list[Run] = []
    for k, place in sorted((bit.actuator.bit_length() - 1, bit.place.bit_length() - 1) for bit in bits):
        size = runs[-1].mask.bit_length() if runs else 0
        if runs and (runs[-1].actuator + size, runs[-1].place + size) == (k, place):
            runs[-1] = runs[-1]._replace(mask=runs[-1].mask << 1 | 1)
        else:
            runs.append(Run(k, 1, place))
    return tuple(runs)


def _groups(outputs: dict[_Place, tuple[int, ...]], shared: bool) -> list[list[_Place]]:
    """Boards whose bytes share a frame: of one bus only, and no board in two frames."""
    groups: list[list[_Place]] = []
    for place, subs in outputs.items():
        last = groups[-1] if groups else []
        room = _FRAME_BYTES - sum(len(outputs[other]) for other in last)
        if shared and last and last[0].bus == place.bus and len(subs) <= room:
            last.append(place)
        else:
            groups.append([place])
    return groups


def _subs(bits: Iterable[int]) -> tuple[int, ...]:
    return tuple(sorted({1 + bit // 8 for bit in bits}))


def _bit(channel: int, subs: tuple[int, ...]) -> int:
    """The bit of an output or input in the number that the bytes of the used sub-indices make."""
    return 8 * subs.index(1 + channel // 8) + channel % 8
