"""Requests to lock or unlock an actuator: strict decoding."""

from typing import Literal

from msgspec import Struct

from controller.motion.setpoint import parse


class DegradeMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of `degrade`: an actuator and the state to lock it in; null unlocks it."""

    actuator: str
    state: Literal[0, 1] | None


def decode(payload: bytes) -> DegradeMessage:
    """Returns the message in a payload.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    return parse(payload, DegradeMessage, "degrade")
