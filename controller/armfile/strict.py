"""Strict conversion of YAML and JSON values to msgspec structs; each fault is reported with the path of its field."""

import math
from collections.abc import Sequence
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Struct

from hyperbit.controller.armfile.choices import (
    description_of,
    hint_of,
    must_be,
    tags_of,
    unknown_field,
    values_of,
    wrong_choice,
)
from hyperbit.controller.armfile.units import Factors, value_in

S = TypeVar("S", bound=Struct)

MOST_FAULTS = 100
NO_UNITS: Factors = {}
UNIT = 1e-3  # tolerance of a quaternion's length, because it may be written with few digits


class InputFaults(ValueError):
    """All faults of one file.

    Attributes:
        faults: each fault in printable form, as "path: fault".
        lines: line of the file for each fault, None where unknown; empty if no line was looked for.
    """

    def __init__(self, path: Path, faults: Sequence[str], lines: Sequence[int | None] = ()) -> None:
        """Stores the faults; the message has one line for each."""
        self.faults = tuple(fault.encode("utf-8", "backslashreplace").decode() for fault in faults)
        self.lines, self._path = tuple(lines), path
        super().__init__(fault_list(str(path), self.faults, self.lines))

    def __reduce__(self) -> tuple[Any, ...]:
        """Returns how pickle builds the exception again, in another process."""
        return InputFaults, (self._path, self.faults, self.lines)


def fault_list(file: str, faults: Sequence[str], lines: Sequence[int | None] = ()) -> str:
    """Returns a message with one line for each fault, such as "arm.yaml, line 12: modules[1].width: ..."."""
    places = [file if line is None else f"{file}, line {line}" for line in lines] or [file] * len(faults)
    return "\n".join(f"{place}: {fault}" for place, fault in zip(places, faults, strict=True))


def check(value: Any, kind: type[S], faults: list[str], units: Factors = NO_UNITS) -> S | None:
    """Returns `value` as a struct, or None with each fault appended as "path: fault".

    `units` says what texts such as "30 deg" stand for; without it a number in a text is a fault.
    """
    before = len(faults)
    plain = validated(value, kind, "", faults, units)
    del faults[MOST_FAULTS:]
    return msgspec.convert(plain, kind) if len(faults) == before else None


def validated(value: Any, kind: Any, path: str, faults: list[str], units: Factors = NO_UNITS) -> Any:
    """Returns `value` with numbers for texts with units; appends its faults against the type `kind`, part by part."""
    kind = union_member(value, kind)
    tags = tags_of(kind) if isinstance(value, dict) else None
    if tags is not None:
        name, known_tags = tags
        missing = f"required, but missing; {must_be(known_tags)}"
        fault = wrong_choice(value[name], shown(value[name]), known_tags) if name in value else missing
        faults.append(f"{join(path, name)}: {fault}")
        return value
    if isinstance(kind, type) and issubclass(kind, Struct) and isinstance(value, dict):
        return _struct(value, kind, path, faults, units)
    if isinstance(value, dict) and get_origin(kind) is dict:
        names, kinds = get_args(kind)
        for name in value:
            validated(name, names, join(path, f"{name!s:.80}"), faults)
        parts = ((name, validated(it, kinds, join(path, f"{name!s:.80}"), faults, units)) for name, it in value.items())
        return dict(parts)
    elements = element_types(kind, len(value)) if isinstance(value, list) else None
    before = len(faults)
    if elements is not None:
        listed = zip(value, elements, strict=True)
        value = [validated(it, own, f"{path}[{k}]", faults, units) for k, (it, own) in enumerate(listed)]
    if isinstance(value, str) and (known := units.get(description_of(kind))) is not None:
        number = value_in(value, known)
        value = value if number is None else number
    if len(faults) == before:
        _scalar(value, kind, path, faults, in_file=bool(units))
    return value


def _struct(value: dict[str, Any], kind: type[Struct], path: str, faults: list[str], units: Factors) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    config = kind.__struct_config__
    known = set(kind.__struct_encode_fields__) | ({config.tag_field} if config.tag_field else set())
    faults += [f"{join(path, name)}: {unknown_field(name, known)}" for name in value if name not in known]
    required = [f for f in msgspec.structs.fields(kind) if f.required]
    faults += [f"{join(path, f.name)}: required, but missing" for f in required if f.name not in value]
    own = {
        name: validated(value[name], hints[name], join(path, name), faults, units)
        for name in kind.__struct_fields__
        if name in value
    }
    return {**value, **own}


def _scalar(value: Any, kind: Any, path: str, faults: list[str], *, in_file: bool) -> None:
    """Appends the fault of a value whose parts are right, or that has none; `in_file`: of a file that has units."""
    if isinstance(value, float) and not math.isfinite(value):
        faults.append(f"{path}: {value} is not a finite number")
        return
    choices = [each for each in values_of(kind) if isinstance(each, str)]
    if choices and isinstance(value, str | bool) and not is_kind(value, kind):
        faults.append(f"{path or 'file'}: {wrong_choice(value, shown(value), choices)}")
        return
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        text, _, inner = str(error).partition(" - at `$")
        inner = inner.rstrip("`") if inner else ""
        hint = "" if inner else hint_of(value, kind, in_file=in_file)
        if not inner and (form := description_of(kind)) and " matching regex " in text:
            text, hint = f"{text.partition(' matching')[0]} of {form}", ""
        faults.append(f"{(path + inner).lstrip('.') or 'file'}: {text} (given: {shown(value)}){hint}")
    except UnicodeEncodeError:  # a lone surrogate, which JSON and YAML can contain
        faults.append(f"{path.lstrip('.') or 'file'}: a lone surrogate is no text (given: {shown(value)})")


def union_member(value: Any, kind: Any) -> Any:
    """Returns the member of a union that `value` is meant to be; `kind` itself if it is no union."""
    if get_origin(kind) not in (Union, UnionType):
        return kind
    members = [m for m in get_args(kind) if m is not type(None)]
    structs = [m for m in members if isinstance(m, type) and issubclass(m, Struct)]
    if isinstance(value, dict) and structs:
        tagged = [m for m in structs if m.__struct_config__.tag == value.get(m.__struct_config__.tag_field or "")]
        untagged = [m for m in structs if m.__struct_config__.tag is None]
        if tagged or untagged:
            return (tagged or untagged)[0]
    if isinstance(value, list):
        lists = [m for m in members if element_types(m, len(value)) is not None]
        if lists:
            return lists[0]
    return kind


def is_kind(value: Any, kind: Any) -> bool:
    """Returns whether a scalar suits a type."""
    try:
        msgspec.convert(value, kind)
    except (msgspec.ValidationError, UnicodeEncodeError):
        return False
    return True


def element_types(kind: Any, count: int) -> list[Any] | None:
    """Returns the types of `count` elements of a list or tuple type, also behind Annotated; None for another type.

    A tuple of another length has no element types: its length is the fault.
    """
    if hasattr(kind, "__metadata__"):
        kind = kind.__origin__
    if get_origin(kind) is list:
        return [get_args(kind)[0]] * count
    types = list(get_args(kind)) if get_origin(kind) is tuple else []
    return types if types and len(types) == count else None


def join(path: str, name: object) -> str:
    """Returns the path of a field."""
    return f"{path}.{name}" if path else str(name)


def shown(value: Any) -> str:
    """Returns a value as text for a message, cut short."""
    try:
        text = repr(value)
    except ValueError:  # the integer has more digits than Python converts
        return "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."
