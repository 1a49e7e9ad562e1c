"""Messages to bytes and back: CDR by rosbags, with bounds on what comes from the network."""

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.serde import SerdeError

from hyperbit.controller.ros2.wire.types import Types, UnknownType

MOST_BYTES = 1_000_000  # of a message that is read
HEADER = b"\x00\x01\x00\x00"  # CDR, little endian
# Defaults that are not zero.
DEFAULTS: dict[str, dict[str, Any]] = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}
ERRORS = (SerdeError, struct.error, ValueError, TypeError, AttributeError, LookupError, OverflowError)
ZERO: dict[str, object] = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}
NUMPY = {"bool": "bool", "byte": "int8", "char": "uint8"}  # other types have their own name


class BadMessage(ValueError):
    """Bytes are no message of a type, or a value does not fit into it."""


def serialize(value: Any, name: str, types: Types) -> bytes:
    """Returns the bytes of a message or its fields, see `message`. Raises BadMessage or UnknownType."""
    if isinstance(value, Mapping):
        value = message(value, name, types)
    expected = types.message_class(name)
    if not isinstance(value, expected):
        raise BadMessage(f"expected a message {name}, not {type(value).__name__}")
    try:
        return bytes(types.store.serialize_cdr(value, name, little_endian=True))
    except ERRORS as error:
        raise BadMessage(f"this is no {name}: {error}") from None


def deserialize(data: bytes, name: str, types: Types) -> Any:
    """Returns the message of these bytes. Numbers are not checked: they may be NaN or infinite.

    Raises:
        BadMessage: there are too many bytes or too few, the header is not that of CDR, or a text is no UTF-8.
        UnknownType: the type is not known.
    """
    types.message_class(name)
    if len(data) > MOST_BYTES:
        raise BadMessage(f"a message of {len(data)} bytes is too long: at most {MOST_BYTES} are read")
    try:
        return types.store.deserialize_cdr(data, name)
    except ERRORS as error:
        raise BadMessage(f"{len(data)} bytes are no {name}: {error}") from None


def message(fields: Mapping[str, Any], name: str, types: Types) -> Any:
    """Returns a message with these fields; others are zero, empty or the type's default.

    Args:
        fields: values by name: numbers, texts, sequences, messages, or mappings with the fields of nested messages.

    Raises:
        BadMessage: there is no such field, or its value does not fit.
        UnknownType: the type is not known.
    """
    cls = types.message_class(name)
    _, entries = types.store.fielddefs[name]
    if unknown := fields.keys() - {field for field, _ in entries}:
        raise BadMessage(f"{name} has no field {', '.join(map(repr, sorted(unknown)))}")
    given = {**DEFAULTS.get(name, {}), **fields}
    values = {}
    for field, desc in entries:
        try:
            values[field] = _value(desc, given.get(field), types)
        except (BadMessage, UnknownType):
            raise
        except ERRORS as error:
            raise BadMessage(f"{name}: field {field!r}: {error}") from None
    return cls(**values)


def _value(desc: FieldDesc, given: Any, types: Types) -> Any:
    if desc[0] == Nodetype.NAME:
        return message(given or {}, desc[1], types) if given is None or isinstance(given, Mapping) else given
    if desc[0] == Nodetype.BASE:
        return ZERO.get(desc[1][0], 0) if given is None else given
    element, length = desc[1]
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        kind = NUMPY.get(element[1][0], element[1][0])
        if given is None:
            given = [0] * length if desc[0] == Nodetype.ARRAY else []
        elif isinstance(given, bytes | bytearray):
            given = list(given)
        return np.ascontiguousarray(np.asarray(given, dtype=kind).reshape(-1))
    values = [None] * length if given is None and desc[0] == Nodetype.ARRAY else list(given or ())
    return [_value(element, value, types) for value in values]
