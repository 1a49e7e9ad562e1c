"""Payloads that answer requests: done, or refused and why."""

from controller.motion import codes
from controller.planning.core.events import Payload

CLOSING = "the daemon is shutting down; the arm holds"


def done(message: str) -> Payload:
    """Returns the answer to a request that was carried out."""
    return {"accepted": True, "code": codes.SUCCESSFUL, "message": message}


def refused(code: int, message: str, goal: str | None = None) -> Payload:
    """Returns the answer to a request that was refused; `goal` is its id, if it is known."""
    return {"accepted": False, "id": goal, "code": code, "message": message}
