"""Hints in faults: the nearest of several names, the values that a field may have, and numbers with their units."""

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from msgspec import Struct

NUMBER = re.compile(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?)\s*([a-zA-Zµ°/]*)")
DECIMAL_COMMA = re.compile(r"([-+]?[0-9]+),([0-9]+)")
LARGEST = 1e6  # of lengths and other numbers; greater ones are mistakes of the unit, and overflow when they are squared
LARGEST_ANGLE = 12.5664  # [rad], two turns; greater ones are degrees
MOST_DEGREES = 720.0
RADIANS, SECONDS, BITS = "in radians", "in seconds", "in bit/s"
LENGTH = "in the unit of the arm's file"
UNITS = {  # factor of a unit, and what the field expects
    "us": (1e-6, "seconds"),
    "µs": (1e-6, "seconds"),
    "ms": (1e-3, "seconds"),
    "s": (1.0, "seconds"),
    "sec": (1.0, "seconds"),
    "min": (60.0, "seconds"),
    "deg": (math.pi / 180, "radians"),
    "°": (math.pi / 180, "radians"),
    "rad": (1.0, "radians"),
    "kbit/s": (1e3, "bit/s"),
    "Mbit/s": (1e6, "bit/s"),
}
LENGTHS = ("um", "µm", "mm", "cm", "dm", "m", "in", "ft")


def nearest(name: object, names: Iterable[object]) -> str | None:
    """Returns the name most like another one; None if none is alike."""
    found = difflib.get_close_matches(str(name)[:80], [str(each) for each in names], n=1)
    return found[0] if found else None


def must_be(values: Iterable[object]) -> str:
    """Returns which values a field may have, e.g. "it must be one of hold, contract"."""
    known = ["null" if value is None else str(value) for value in values]
    return f"it must be {'one of ' * (len(known) > 1)}{', '.join(known)}"


def wrong_choice(value: object, shown: str, values: Sequence[object]) -> str:
    """Returns the fault of a value that is none of those which its field may have.

    Args:
        value: the value.
        shown: the value as text.
        values: what the field may have.
    """
    choices = must_be(values)
    if isinstance(value, bool):
        plain, words = ("true", "on, yes and true") if value else ("false", "off, no and false")
        return f"{plain}, but {choices}; YAML reads {words} without quotes as {plain}"
    like = nearest(value, values) if isinstance(value, str) else None
    return f"{shown} is unknown; " + (f"did you mean {like!r}? I{choices[1:]}" if like else choices)


def unknown_field(name: object, known: Iterable[str]) -> str:
    """Returns the fault of a field that does not exist."""
    names = sorted(known)
    like = nearest(name, names)
    return f"unknown field; {f'did you mean {like!r}? Known' if like else 'known'} are {', '.join(names)}"


def values_of(kind: Any) -> list[object]:
    """Returns the values that the literals of a type name; other members of a union add none."""
    if hasattr(kind, "__metadata__"):
        kind = kind.__origin__
    if get_origin(kind) is Literal:
        return list(get_args(kind))
    if get_origin(kind) in (Union, UnionType):
        return list(dict.fromkeys(value for member in get_args(kind) for value in values_of(member)))
    return []


def tags_of(kind: Any) -> tuple[str, list[object]] | None:
    """Returns the tag field of a union of tagged structs, and its values; None if the type is none."""
    if get_origin(kind) not in (Union, UnionType):
        return None
    configs = [m.__struct_config__ for m in get_args(kind) if isinstance(m, type) and issubclass(m, Struct)]
    tagged = [config for config in configs if config.tag_field is not None]
    if not tagged or len(tagged) < len(configs):
        return None
    return str(tagged[0].tag_field), [config.tag for config in tagged]


def hint_of(value: object, kind: Any, *, in_file: bool = False) -> str:
    """Returns what to write in place of a value that does not suit a type, e.g. "; write 0.1 (seconds)"; else "".

    `in_file`: the value is of an arm's file, which may name the unit of its lengths.
    """
    unit = description_of(kind)
    in_unit = f"; {unit}" if unit else ""
    if unit == RADIANS and isinstance(value, int | float):
        return degrees_hint(value)
    if isinstance(value, str) and takes(kind, int, float):
        return number_hint(value, unit, in_file=in_file) or in_unit
    if isinstance(value, int | float) and takes(kind, str):
        return "; write it in quotes"
    if isinstance(value, list) and get_origin(kind) is dict:
        return "; a list has no names: write NAME: {...} for each"
    return in_unit


def number(text: str, most: float = LARGEST, least: float | None = None) -> float:
    """Returns the number that a field of a file or command line is: decimal digits, a point, an exponent.

    Args:
        text: the field.
        most: greatest number.
        least: least number; None: -`most`.

    Raises:
        ValueError: the text is none, or the number is out of these bounds.
    """
    least, match = -most if least is None else least, NUMBER.fullmatch(text.strip())
    if match is None or match[2]:
        raise ValueError(f"a number is needed, got {text!r}{number_hint(text)}")
    if not least <= (value := float(match[1])) <= most:
        degrees = degrees_hint(value) if most == LARGEST_ANGLE else ""
        raise ValueError(f"a number from {least:g} to {most:g} is needed, got {text!r}{degrees}")
    return value


def degrees_hint(value: float) -> str:
    """Returns what to write in place of an angle that is too large for radians."""
    if abs(value) > MOST_DEGREES:
        return f"; {RADIANS}"
    return f"; in radians, {value:g} degrees are {math.radians(value):.4g}"


def number_hint(text: str, expected: str = "", *, in_file: bool = False) -> str:
    """Returns what to write in place of a number that is given as text; "" if the text is no number.

    `expected` is the unit of its field, such as SECONDS, "" if it has none. `in_file`: see hint_of.
    """
    if (comma := DECIMAL_COMMA.fullmatch(text.strip())) is not None:
        decimal = f"{comma[1]}.{comma[2]}"
        if len(comma[2]) == 3 and comma[1].lstrip("+-") != "0":
            return f"; write {decimal}, or {comma[1]}{comma[2]} if the comma separates thousands"
        return f"; write a decimal point: {decimal}"
    match = NUMBER.fullmatch(text.strip())
    if match is None:
        return ""
    value, unit = float(match[1]), match[2]
    if unit in LENGTHS and expected == LENGTH and in_file:
        return "; write a number without a unit, or name the unit of all lengths, as in unit: mm"
    meant = LENGTH if unit in LENGTHS else f"in {UNITS[unit][1]}" if unit in UNITS else expected
    if expected not in ("", meant):
        return f"; this number is {expected}"
    if unit in LENGTHS:
        return "; write a number without a unit: all lengths of a file have the same one"
    if not unit:
        return f"; YAML reads it as text: write {plain(value)}"
    if unit not in UNITS:
        return "; write a number without a unit"
    factor, name = UNITS[unit]
    return f"; write {plain(value * factor)} ({name})"


def description_of(kind: Any) -> str:
    """Returns the description of a type, or of a member of a union: its unit, or its characters; "" without one."""
    members = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    named = [meta.description for member in members for meta in getattr(member, "__metadata__", ())]
    return next(filter(None, named), "")


def takes(kind: Any, *plain_types: type) -> bool:
    """Returns whether a type, or a member of a union, is one of these plain types."""
    if hasattr(kind, "__metadata__"):
        kind = kind.__origin__
    if get_origin(kind) in (Union, UnionType):
        return any(takes(member, *plain_types) for member in get_args(kind))
    return kind in plain_types


def plain(number: float) -> str:
    """Returns a number in a form that YAML 1.1 reads as a number: with an exponent it needs a point and a sign."""
    text = f"{number:.10g}"
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{exponent}" if e else text
