"""Units of length: what an arm's file may name, and what its lengths are in metres."""

import math
from collections.abc import Mapping
from typing import Literal, get_args

from hyperbit.controller.armfile.choices import LENGTH, NUMBER, UNITS

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
