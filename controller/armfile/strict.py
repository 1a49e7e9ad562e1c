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

S = TypeVar("S", bound=Struct)

MOST_FAULTS = 100
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


def check(value: Any, kind: type[S], faults: list[str]) -> S | None:
    """Returns `value` as a struct, or None with each fault appended as "path: fault"."""
    before = len(faults)
    validate(value, kind, "", faults)
    del faults[MOST_FAULTS:]
    return msgspec.convert(value, kind) if len(faults) == before else None


def validate(value: Any, kind: Any, path: str, faults: list[str]) -> None:
    """Appends the faults of `value` against the type `kind`; structs, dicts and lists are checked part by part."""
    kind = union_member(value, kind)
    tags = tags_of(kind) if isinstance(value, dict) else None
    if tags is not None:
        name, known_tags = tags
        missing = f"required, but missing; {must_be(known_tags)}"
        fault = wrong_choice(value[name], shown(value[name]), known_tags) if name in value else missing
        faults.append(f"{join(path, name)}: {fault}")
        return
    if isinstance(kind, type) and issubclass(kind, Struct) and isinstance(value, dict):
        hints = get_type_hints(kind, include_extras=True)
        config = kind.__struct_config__
        known = set(kind.__struct_encode_fields__) | ({config.tag_field} if config.tag_field else set())
        faults += [f"{join(path, name)}: {unknown_field(name, known)}" for name in value if name not in known]
        required = [f for f in msgspec.structs.fields(kind) if f.required]
        faults += [f"{join(path, f.name)}: required, but missing" for f in required if f.name not in value]
        for name in kind.__struct_fields__:
            if name in value:
                validate(value[name], hints[name], join(path, name), faults)
        return
    if isinstance(value, dict) and get_origin(kind) is dict:
        for name, element in value.items():
            validate(name, get_args(kind)[0], join(path, f"{name!s:.80}"), faults)
            validate(element, get_args(kind)[1], join(path, f"{name!s:.80}"), faults)
        return
    elements = element_type(kind)
    if isinstance(value, list) and elements is not None:
        before = len(faults)
        for k, element in enumerate(value):
            validate(element, elements, f"{path}[{k}]", faults)
        if len(faults) > before:
            return
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
        hint = "" if inner else hint_of(value, kind)
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
        lists = [m for m in members if element_type(m) is not None]
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


def element_type(kind: Any) -> Any:
    """Returns the element type of a list type, also behind Annotated; None for any other type."""
    if hasattr(kind, "__metadata__"):
        kind = kind.__origin__
    return get_args(kind)[0] if get_origin(kind) is list else None


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
