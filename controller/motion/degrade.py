"""Requests to hold an actuator in a state, or to use it again: strict decoding."""

from typing import Literal

from msgspec import Struct

from controller.motion.setpoint import parse


class DegradeMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of `degrade`: an actuator, and the state to hold it in, null to use it like any other."""

    actuator: str
    state: Literal[0, 1] | None


def decode(payload: bytes) -> DegradeMessage:
    """Returns the message in a payload.

    Raises:
        Refusal: what is wrong, by field; nothing else, whatever the bytes.
    """
    return parse(payload, DegradeMessage, "degrade")
