"""What is said to peers: JSON, and the two kinds of answer to a request."""

from typing import Any

import msgspec
import numpy as np

from controller.daemon.events import Payload
from controller.motion import codes


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


def done(message: str) -> Payload:
    """Returns the answer to a request that was carried out."""
    return {"accepted": True, "code": codes.SUCCESSFUL, "message": message}


def refused(code: int, message: str, goal: str | None = None) -> Payload:
    """Returns the answer to a request that was not; `goal` is its id, where it is known."""
    return {"accepted": False, "id": goal, "code": code, "message": message}
