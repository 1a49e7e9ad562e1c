"""Units: which numbers of an arm's file have one, what the file may name, and what its lengths are in metres."""

import math
from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from msgspec.inspect import is_struct_type
from msgspec.structs import fields

from hyperbit.controller.armfile.choices import LENGTH, NUMBER, UNITS, description_of

Unit = Literal["m", "cm", "mm", "in"]
NAMES: tuple[Unit, ...] = get_args(Unit)

MILLIMETRES: Mapping[str, float] = {"m": 1000.0, "cm": 10.0, "mm": 1.0, "in": 25.4}
UNNAMED = "unit of the arm's file"  # of an arm whose file names none
METRES_TAKEN = "the arm's file names no unit: its lengths count as metres"

# Factor of each unit, by the description of the type that a number in this unit belongs to.
Factors = Mapping[str, Mapping[str, float]]


def unit_name(unit: str | None) -> str:
    """Returns what labels have for a unit: its sign, or words if the file names none."""
    return unit or UNNAMED


def unit_mark(unit: str | None) -> str:
    """Returns what follows a length in a sentence: its unit, or nothing if the file names none."""
    return f" {unit}" if unit else ""


def metres_of(unit: object) -> float:
    """Returns the length of a unit in metres; 1 for None, which counts as metres. Raises ValueError if unknown."""
    if unit is None:
        return 1.0
    if not isinstance(unit, str) or unit not in MILLIMETRES:
        raise ValueError(f"unit: {unit!r:.40} is none of {', '.join(MILLIMETRES)}")
    return MILLIMETRES[unit] / 1000.0


def factors(unit: object) -> Factors:
    """Returns what numbers with a unit may stand for in a file; lengths only if the file names a `unit`."""
    found: dict[str, dict[str, float]] = {}
    for name, (factor, base) in UNITS.items():
        found.setdefault(f"in {base}", {})[name] = factor
    if isinstance(unit, str) and unit in MILLIMETRES:
        found[LENGTH] = {name: size / MILLIMETRES[unit] for name, size in MILLIMETRES.items()}
    return found


def value_in(text: str, known: Mapping[str, float]) -> float | None:
    """Returns the number of a text such as "30 deg"; None unless the text is a number with one of the known units."""
    match = NUMBER.fullmatch(text.strip())
    if match is None or match[2] not in known:
        return None
    value = float(match[1]) * known[match[2]]
    return value if math.isfinite(value) else None


def numbers_of(kind: Any, value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[Any, float, str]]:
    """Yields each number with a unit: its place, its value and the description of its type, such as RADIANS.

    Args:
        kind: type of the value, as a field of the file has it.
        value: as plain sequences, dictionaries and numbers.
        place: keys and indices of the value.
    """
    if isinstance(value, float | int):
        if unit := description_of(kind):
            yield place, value, unit
        return
    for member in get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,):
        member = getattr(member, "__origin__", member) if hasattr(member, "__metadata__") else member
        if isinstance(value, list | tuple) and get_origin(member) in (list, tuple):
            for k, part in enumerate(value):
                yield from numbers_of(get_args(member)[0], part, (*place, k))
        elif isinstance(value, dict) and is_struct_type(member) and value.get("type") == member.__struct_config__.tag:
            for it in fields(member):
                yield from numbers_of(it.type, value.get(it.name), (*place, it.name))
