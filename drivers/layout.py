"""Where each actuator's bit lies in the boards' bytes, and which bytes share a frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import cia301
from drivers.wiring import Channel, Wiring

_FRAME_BYTES = 8


@dataclass(frozen=True)
class Board:
    """What is wired to one board.

    Attributes:
        bus: its bus.
        node: its node id.
        outputs: sub-indices of 6200h in use, ascending.
        inputs: sub-indices of 6000h in use, ascending.
        rpdo: COB-ID of the frame that carries its outputs.
        mapping: entries of 1600h, dummies included.
        image: its bytes in the image of all outputs.
        input_image: its bytes in the image of all inputs.
    """

    bus: str
    node: int
    outputs: tuple[int, ...]
    inputs: tuple[int, ...]
    rpdo: int
    mapping: tuple[int, ...]
    image: slice
    input_image: slice

    @property
    def name(self) -> str:
        """As in messages, e.g. "can0/5"."""
        return f"{self.bus}/{self.node}"


@dataclass(frozen=True)
class Frame:
    """One RPDO frame: its COB-ID on its bus, and its bytes in the image of all outputs."""

    bus: str
    cob_id: int
    image: slice


@dataclass(frozen=True)
class Layout:
    """All boards and frames of a wiring, and the place of each of the A actuators in the images.

    Attributes:
        boards: by bus and node id.
        frames: in the order of the image.
        board: (A,) index of each actuator's board.
        byte: (A,) index into the image of all outputs.
        bit: (A,) bit in that byte.
        input_byte: (A,) index into the image of all inputs, 0 without an end-stop.
        input_bit: (A,) bit in that byte.
        sensed: (A,) whether there is an end-stop.
        size: length of the image of all outputs.
        input_size: length of the image of all inputs.
    """

    boards: tuple[Board, ...]
    frames: tuple[Frame, ...]
    board: NDArray[np.intp]
    byte: NDArray[np.intp]
    bit: NDArray[np.uint8]
    input_byte: NDArray[np.intp]
    input_bit: NDArray[np.uint8]
    sensed: NDArray[np.bool_]
    size: int
    input_size: int


def lay_out(wiring: Wiring) -> Layout:
    """Lays the boards' bytes out in frames."""
    order = {bus.name: i for i, bus in enumerate(wiring.buses)}
    wired: dict[tuple[str, int], list[Channel]] = {}
    for channel in sorted(wiring.channels, key=lambda c: (order[c.bus], c.node)):
        wired.setdefault((channel.bus, channel.node), []).append(channel)
    outputs = {place: _subs(c.output for c in channels) for place, channels in wired.items()}
    inputs = {place: _subs(c.input for c in channels if c.input is not None) for place, channels in wired.items()}

    boards: list[Board] = []
    frames: list[Frame] = []
    start = input_start = 0
    for group in _groups(outputs, wiring.shared_rpdo):
        bus, first = group[0]
        frame = Frame(bus, cia301.RPDO1 + first, slice(start, start + sum(len(outputs[place]) for place in group)))
        frames.append(frame)
        for place in group:
            here = slice(start, start + len(outputs[place]))
            mapping = [cia301.DUMMY_BYTE] * (here.start - frame.image.start)
            mapping += [cia301.mapping(0x6200, sub) for sub in outputs[place]]
            mapping += [cia301.DUMMY_BYTE] * (frame.image.stop - here.stop)
            input_here = slice(input_start, input_start + len(inputs[place]))
            boards.append(Board(*place, outputs[place], inputs[place], frame.cob_id, tuple(mapping), here, input_here))
            start, input_start = here.stop, input_here.stop
    return _index(wiring.channels, tuple(boards), tuple(frames))


def _groups(outputs: dict[tuple[str, int], tuple[int, ...]], shared: bool) -> list[list[tuple[str, int]]]:
    """Boards, as bus and node, whose bytes travel in one frame: of one bus only, and no board in two frames."""
    groups: list[list[tuple[str, int]]] = []
    for place, subs in outputs.items():
        last = groups[-1] if groups else []
        room = _FRAME_BYTES - sum(len(outputs[other]) for other in last)
        if shared and last and last[0][0] == place[0] and len(subs) <= room:
            last.append(place)
        else:
            groups.append([place])
    return groups


def _subs(bits: Iterable[int]) -> tuple[int, ...]:
    return tuple(sorted({1 + bit // 8 for bit in bits}))


def _index(channels: tuple[Channel, ...], boards: tuple[Board, ...], frames: tuple[Frame, ...]) -> Layout:
    number = {(board.bus, board.node): i for i, board in enumerate(boards)}
    board = [number[c.bus, c.node] for c in channels]
    byte = [
        boards[b].image.start + boards[b].outputs.index(1 + c.output // 8) for b, c in zip(board, channels, strict=True)
    ]
    input_byte = [
        0 if c.input is None else boards[b].input_image.start + boards[b].inputs.index(1 + c.input // 8)
        for b, c in zip(board, channels, strict=True)
    ]
    return Layout(
        boards=boards,
        frames=frames,
        board=np.array(board, dtype=np.intp),
        byte=np.array(byte, dtype=np.intp),
        bit=np.array([c.output % 8 for c in channels], dtype=np.uint8),
        input_byte=np.array(input_byte, dtype=np.intp),
        input_bit=np.array([(c.input or 0) % 8 for c in channels], dtype=np.uint8),
        sensed=np.array([c.input is not None for c in channels], dtype=np.bool_),
        size=sum(len(b.outputs) for b in boards),
        input_size=sum(len(b.inputs) for b in boards),
    )
