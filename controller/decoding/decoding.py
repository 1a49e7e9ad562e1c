"""The door for bytes of wires and files: typed data comes out, or one kind of error that says why not.

No other module knows which exceptions of which library mean that bytes cannot be read.
"""

import functools
import json
from typing import Any, TypeVar, overload

import msgspec

T = TypeVar("T")

# msgspec raises UnicodeError for a text that is no UTF-8, and RecursionError for deep nesting.
ERRORS = (msgspec.MsgspecError, UnicodeError, RecursionError)
# Code that reads untyped data raises these if the data has another form, as a message of another version.
OTHER_FORM = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError, MemoryError)


class Unreadable(ValueError):
    """Bytes are no data of the expected kind; the text says why.

    `form`: they are JSON or MessagePack, of another form; `deep`: nested too deeply.
    """

    def __init__(self, error: Exception | str) -> None:
        super().__init__(str(error))
        self.form = isinstance(error, msgspec.ValidationError)
        self.deep = isinstance(error, RecursionError)


@overload
def decode(data: bytes | str, kind: type[T]) -> T: ...
@overload
def decode(data: bytes | str, kind: Any = ...) -> Any: ...  # of a union
def decode(data: bytes | str, kind: Any = Any) -> Any:
    """Returns the value of a JSON text. Numbers are finite. Raises Unreadable for anything else."""
    try:
        return _json(kind).decode(data)
    except ERRORS as error:
        raise Unreadable(error) from None


def decode_packed(data: bytes, kind: Any) -> Any:
    """Returns the value of a MessagePack. Raises Unreadable for anything else."""
    try:
        return _msgpack(kind).decode(data)
    except ERRORS as error:
        raise Unreadable(error) from None


def convert(value: Any, kind: type[T]) -> T:
    """Returns plain data as a kind. Raises Unreadable if it has another form."""
    try:
        return msgspec.convert(value, kind)
    except (*ERRORS, OverflowError) as error:
        raise Unreadable(error) from None


def decode_once(text: str) -> Any:
    """Returns the plain value of a JSON text, but refuses a name that occurs twice in one object.

    Python's numbers that are not finite, and half surrogate pairs, are left to a check that can name their field.

    Raises:
        Unreadable: a name occurs twice, or the text is no JSON.
    """
    try:
        return json.loads(text, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise Unreadable(error) from None


@functools.cache
def _json(kind: Any) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)


@functools.cache
def _msgpack(kind: Any) -> msgspec.msgpack.Decoder[Any]:
    return msgspec.msgpack.Decoder(kind)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Returns the object of name-value pairs; json.loads would silently keep the last of equal names."""
    fields = dict(pairs)
    if len(fields) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise ValueError(f"{twice!r} occurs twice in one object")
    return fields
