"""Requests to switch single actuators, in any configuration or none: strict decoding."""

from collections.abc import Sequence
from typing import Annotated, Literal

from msgspec import Meta, Struct

from controller.motion.goal import refusal
from controller.motion.setpoint import parse

STATES = ("contracted", "extended")


class JogMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of `jog`: the new state of each actuator, by label."""

    actuators: Annotated[dict[str, Literal["contracted", "extended"]], Meta(min_length=1)]


def decode(payload: bytes, actuators: Sequence[str]) -> dict[int, int]:
    """Returns the states in a payload, 0 contracted and 1 extended, by index of the actuator.

    Args:
        payload: JSON.
        actuators: labels, in the order of the state vectors.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    message = parse(payload, JogMessage, "jog")
    indices = {label: k for k, label in enumerate(actuators)}
    if unknown := [label for label in message.actuators if label not in indices]:
        shown = unknown[0] if len(unknown[0]) <= 60 else unknown[0][:57] + "..."
        known = f"{actuators[0]} to {actuators[-1]}"
        raise refusal(f"actuators: {shown!r} is none of this arm's, which are {known}")
    return {indices[label]: STATES.index(state) for label, state in message.actuators.items()}
