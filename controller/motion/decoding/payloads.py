"""Strict decoding of JSON payloads into messages."""

from typing import Any, TypeVar

import msgspec
from msgspec import Struct

from hyperbit.controller.armfile.strict import check
from hyperbit.controller.decoding.decoding import Unreadable, convert, decode_once
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, all_faults

S = TypeVar("S", bound=Struct)

MOST_BYTES = 10_000  # of a message, unless its own bound is greater


def parse(payload: bytes, kind: type[S], name: str, most: int = MOST_BYTES) -> S:
    """Returns the message of a kind, called `name` in refusals, in a payload of at most `most` bytes.

    Raises:
        Refusal: too large, not UTF-8, not JSON, or not a message of this kind. No other exception is raised.
    """
    check_size(payload, name, most)
    return converted(object_in(payload, kind, name), kind, name)


def check_size(payload: bytes, name: str, most: int) -> None:
    """Checks that a payload has at most `most` bytes.

    Raises:
        Refusal: it is larger.
    """
    if len(payload) > most:
        raise Refusal(Reason.TOO_LARGE, what=name, size=len(payload), most=most)


def object_in(payload: bytes, kind: type[Struct], name: str) -> dict[str, Any]:
    """Returns the JSON object in a payload.

    Raises:
        Refusal: not UTF-8, not JSON, a name occurs twice in an object, or not an object.
    """
    try:
        value = decode_once(payload.decode())
    except UnicodeDecodeError as error:
        byte = f"{payload[error.start]:02x}"
        raise Refusal(Reason.NOT_UTF8, what=name, byte=error.start, value=byte) from None
    except Unreadable as error:
        raise Refusal(Reason.NOT_JSON, what=name, error=str(error)) from None
    if not isinstance(value, dict):
        every = msgspec.structs.fields(kind)
        needed = [field for field in every if field.required] or every
        raise Refusal(Reason.NO_OBJECT, what=name, fields=" and ".join(f"`{field.name}`" for field in needed))
    return value


def converted(value: dict[str, Any], kind: type[S], name: str) -> S:
    """Returns an object as a message.

    Raises:
        Refusal: it is none; the refusal names each field at fault.
    """
    try:
        return convert(value, kind)
    except Unreadable:  # the slower check names each fault
        faults: list[str] = []
    try:
        check(value, kind, faults)
    except RecursionError:
        raise Refusal(Reason.NESTED_TOO_DEEPLY, what=name) from None
    raise Refusal(Reason.INVALID_FIELDS, faults=all_faults(faults))
