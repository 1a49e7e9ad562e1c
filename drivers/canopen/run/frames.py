"""RPDO frames of the master, assembled from the RPDOs of the boards that receive them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import Bit, Carried, Pdo, carries, union


class Run(NamedTuple):
    """Successive lines on successive bits, which are copied at once.

    Attributes:
        line: index of the first line.
        mask: as many bits as there are lines, from bit 0.
        place: bit of the first line in the frame.
    """

    line: int
    mask: int
    place: int


@dataclass(frozen=True)
class RpdoFrame:
    """One RPDO frame of the master, which several boards may receive.

    The bytes of the frame are one little-endian number.

    Attributes:
        bus: name of its bus.
        cob_id: its COB-ID.
        size: length [bytes].
        on_sync: whether the boards apply it at the next SYNC, not at once.
        boards: indices of the boards that receive it.
        lines: mask of the lines in it.
        used: mask of their bits in the number.
        inverted: mask of the inverted bits among them.
        bits: lines and their bits in the number.
        runs: the same lines as runs.
    """

    bus: str
    cob_id: int
    size: int
    on_sync: bool
    boards: frozenset[int]
    lines: int
    used: int
    inverted: int
    bits: tuple[Bit, ...]
    runs: tuple[Run, ...]


def assemble(boards: Iterable[BoardLayout], rpdos: Mapping[int, tuple[Pdo, ...]]) -> list[RpdoFrame]:
    """Returns the frames for the RPDOs of boards, by index: one for each bus and COB-ID."""
    takers: dict[tuple[str, int], list[tuple[int, BoardLayout, Pdo]]] = {}
    for i, board in enumerate(boards):
        for pdo in rpdos.get(i, ()):
            takers.setdefault((board.bus, pdo.cob_id), []).append((i, board, pdo))
    frames = []
    for (bus, cob_id), taking in takers.items():
        bits: list[Bit] = []
        for _, board, pdo in taking:
            carried = carries(pdo.mapping, board.settings.object)
            bits += [bit._replace(place=place) for bit in board.outputs if (place := _placed(bit.place, carried))]
        frames.append(
            RpdoFrame(
                bus=bus,
                cob_id=cob_id,
                size=max(pdo.size for _, _, pdo in taking),
                on_sync=all(pdo.on_sync for _, _, pdo in taking),
                boards=frozenset(i for i, _, _ in taking),
                lines=union(bit.line for bit in bits),
                used=union(bit.place for bit in bits),
                inverted=union(bit.place for bit in bits if bit.inverted),
                bits=tuple(bits),
                runs=_runs(bits),
            )
        )
    return frames


def _placed(bit: int, carried: Iterable[Carried]) -> int:
    """Returns the mask of a board's bit in a PDO; 0 if the PDO does not carry it."""
    number = bit.bit_length() - 1
    return union(1 << c.place + number - c.bit for c in carried if c.bit <= number < c.bit + c.width)


def _runs(bits: Iterable[Bit]) -> tuple[Run, ...]:
    runs: list[Run] = []
    for k, place in sorted((bit.line.bit_length() - 1, bit.place.bit_length() - 1) for bit in bits):
        size = runs[-1].mask.bit_length() if runs else 0
        if runs and (runs[-1].line + size, runs[-1].place + size) == (k, place):
            runs[-1] = runs[-1]._replace(mask=runs[-1].mask << 1 | 1)
        else:
            runs.append(Run(k, 1, place))
    return tuple(runs)
