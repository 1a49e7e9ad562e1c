"""PDOs, and the bits of a board that their mappings carry."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from hyperbit.drivers.canopen.wiring import WatchedObject

OUTPUTS, INPUTS = 0x6200, 0x6000  # arrays of bytes (CiA 401)
# The number of a board's inputs has the bits of 6000h, and from this bit on those of its watched objects.
FIRST_WATCHED, WATCHED_BITS = 254 * 8, 32


class Pdo(NamedTuple):
    parameters: int  # index of its communication parameters, from 1400h or 1800h; its mapping is 200h above
    cob_id: int
    mapping: tuple[int, ...]  # entries, dummy entries included
    on_sync: bool = True  # a SYNC applies it; otherwise its frame does at once

    @property
    def size(self) -> int:
        """Length of its frame [bytes]."""
        return (sum(entry & 0xFF for entry in self.mapping) + 7) // 8


class Carried(NamedTuple):
    """Successive bits of a board in a PDO, whose bytes are one little-endian number."""

    bit: int  # the first bit, as in the wiring
    place: int  # position of this bit in the number
    width: int  # number of bits


class Bit(NamedTuple):
    """A line and its bit in a number of little-endian bytes."""

    line: int  # mask of one bit
    place: int  # mask of one bit
    inverted: bool


def first_watched(k: int) -> int:
    """Returns the first bit of the watched object k in the number of a board's inputs."""
    return FIRST_WATCHED + WATCHED_BITS * k


def carries(mapping: Iterable[int], base: int, watched: Sequence[WatchedObject] = ()) -> list[Carried]:
    """Returns the bits of a board that a mapping carries; `base` is 6200h, 6000h or a maker's object.

    CiA 401 offers the same bits as bytes, single bits, words and double words. `watched` objects count, too.
    """
    widths = {base: 8}
    if base in (OUTPUTS, INPUTS):
        widths |= {base + 0x20: 1, base + 0x100: 16, base + 0x120: 32}
    carried, place = [], 0
    for entry in mapping:
        index, sub, count = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        if widths.get(index) == count and sub > 0:
            carried.append(Carried((sub - 1) * count, place, count))
        elif (index, sub) in watched:
            first = first_watched(watched.index(WatchedObject(index, sub)))
            carried.append(Carried(first, place, min(count, WATCHED_BITS)))
        place += count
    return carried


def carried_bits(pdos: Iterable[Pdo], base: int, watched: Sequence[WatchedObject] = ()) -> int:
    return union(((1 << c.width) - 1) << c.bit for pdo in pdos for c in carries(pdo.mapping, base, watched))


def subs_of(bits: int) -> tuple[int, ...]:
    """Returns the sub-indices of the bytes that have a bit in a mask."""
    return tuple(1 + byte for byte in range((bits.bit_length() + 7) // 8) if bits >> 8 * byte & 0xFF)


def union(masks: Iterable[int]) -> int:
    whole = 0
    for mask in masks:
        whole |= mask
    return whole
