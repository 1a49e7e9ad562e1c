"""The object dictionary of a simulated board: the standard one, board.eds, with the changes of a variant."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import canopen
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.datatypes import NUMBER_TYPES

EDS = Path(__file__).with_name("board.eds")


class Object(NamedTuple):
    size: int  # [bytes]
    default: bytes  # value after a reset, little-endian
    relative: bool = False  # the node id is added to the default value, as in COB-IDs
    readable: bool = True  # by SDO
    writable: bool = True  # by SDO
    mappable: bool = False  # into a PDO


Objects = Mapping[int, Mapping[int, Object]]  # by index and sub-index
Changes = Mapping[tuple[int, int], Object]


def number(size: int, value: int = 0, **rights: bool) -> Object:
    return Object(size, value.to_bytes(size, "little"), **rights)


def array(index: int, values: Iterable[int], size: int = 1, **rights: bool) -> Changes:
    """Returns the entries of an array: numbers from sub-index 1, their count in sub-index 0."""
    entries = {(index, 1 + i): number(size, value, **rights) for i, value in enumerate(values)}
    return {(index, 0): number(1, len(entries), writable=False), **entries}


def pdo(index: int, cob_id: int, entries: Iterable[int], *, fixed: bool = False) -> Changes:
    """Returns the communication parameters of a PDO, from 1400h or 1800h, and its mapping 200h above.

    `cob_id` has no node id; bit 31 alone is a disabled PDO without a COB-ID. `entries` are of the mapping, read-only if
    `fixed`.
    """
    mapped = list(entries)
    filled = mapped if fixed else mapped + [0] * (8 - len(mapped))
    mapping = {(index + 0x200, 1 + i): number(4, entry, writable=not fixed) for i, entry in enumerate(filled)}
    return {
        (index, 0): number(1, 5, writable=False),
        (index, 1): number(4, cob_id, relative=cob_id & 0x7FF != 0),
        (index, 2): number(1, 255),
        (index, 3): number(2),
        (index, 5): number(2),
        (index + 0x200, 0): number(1, len(mapped), writable=not fixed),
        **mapping,
    }


@functools.cache
def standard() -> Objects:
    described: dict[int, dict[int, Object]] = {}
    for index, found in canopen.import_od(str(EDS), 0).items():
        variables = [found] if isinstance(found, ODVariable) else found.values()
        described[index] = {variable.subindex: _entry(variable) for variable in variables}
    return described


def changed(absent: Iterable[int], read_only: Iterable[int], changes: Changes) -> Objects:
    """Returns the entries of the standard board with changed and read-only ones, without the absent indices."""
    described = {index: dict(subs) for index, subs in standard().items() if index not in absent}
    for index in {index for index, _ in changes}:
        described[index] = {sub: entry for (i, sub), entry in changes.items() if i == index}
    for index in read_only:
        described[index] = {sub: entry._replace(writable=False) for sub, entry in described[index].items()}
    return described


def _entry(variable: ODVariable) -> Object:
    if isinstance(variable.default, int) or variable.data_type in NUMBER_TYPES:
        size = len(variable) // 8 or 1
        default = int(variable.default or 0).to_bytes(size, "little")
    else:
        default = str(variable.default or "").encode("ascii")
        size = len(default)
    return Object(
        size, default, bool(variable.relative), variable.readable, variable.writable, bool(variable.pdo_mappable)
    )
