"""Payloads as JSON."""

from typing import Any

import msgspec
import numpy as np
import zenoh

from controller.planning.core.messages import Payload

JSON = zenoh.Encoding.APPLICATION_JSON


def encode(payload: Payload) -> bytes:
    """Returns a payload as JSON; numbers that are not finite become null.

    Raises:
        TypeError: a value has no JSON form.
        UnicodeEncodeError: a text contains a lone surrogate.
    """
    return msgspec.json.encode(payload, enc_hook=plain)


def plain(value: object) -> Any:
    """Converts NumPy's numbers and arrays to Python's."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be encoded as JSON")


def content(payload: zenoh.ZBytes | None) -> bytes:
    """Returns the bytes of a payload."""
    return b"" if payload is None else payload.to_bytes()
