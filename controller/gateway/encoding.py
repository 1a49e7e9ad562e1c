"""Payloads as JSON."""

from typing import Any

import msgspec
import numpy as np
import zenoh

from controller.planning.messages import Payload

JSON = zenoh.Encoding.APPLICATION_JSON


def encode(payload: Payload) -> bytes:
    """Returns a payload as JSON; a number that is not finite becomes null.

    Raises:
        TypeError: a value has no JSON.
        UnicodeEncodeError: a text holds half a surrogate pair.
    """
    return msgspec.json.encode(payload, enc_hook=plain)


def plain(value: object) -> Any:
    """Returns NumPy's numbers and arrays as Python's."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON")


def content(payload: zenoh.ZBytes | None) -> bytes:
    """Returns the bytes of a payload."""
    return b"" if payload is None else payload.to_bytes()
