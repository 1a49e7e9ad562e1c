"""Requests beside goals: jog, degrade, obstacles and fault. Strict decoding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import Meta, Struct

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.settings import ObstacleList
from hyperbit.controller.motion.decoding.goal import BEGIN_WITHIN, BeginSeconds, Jog
from hyperbit.controller.motion.decoding.payloads import parse
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, all_faults, no_actuator

if TYPE_CHECKING:
    from hyperbit.controller.obstacles.obstacles import Obstacles

MOST_OBSTACLE_BYTES = 200_000  # 256 obstacles with long names and all digits


class JogMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of `jog`: the new state of each actuator, by label, and the longest time to its acceptance [s]."""

    actuators: Annotated[dict[str, Literal["contracted", "extended"]], Meta(min_length=1)]
    begin_within: BeginSeconds = BEGIN_WITHIN


class DegradeMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of `degrade`: an actuator and the state to lock it in; null unlocks it."""

    actuator: str
    state: Literal[0, 1] | None


class ObstaclesMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of `obstacles`: all obstacles beside those of the arm's file, in the same notation."""

    regions: ObstacleList


class FaultMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of `fault`: a fault to play in simulated boards, such as "silence can0/5"."""

    fault: Annotated[str, Meta(min_length=1, max_length=200)]


def decode_jog(payload: bytes, actuators: Sequence[str]) -> Jog:
    """Returns the jog in a JSON payload. `actuators` are all labels, in the order of the state vectors.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    message = parse(payload, JogMessage, "jog")
    indices = {label: k for k, label in enumerate(actuators)}
    if unknown := [label for label in message.actuators if label not in indices]:
        raise no_actuator("actuators", unknown[0], actuators)
    states = {indices[label]: STATES.index(state) for label, state in message.actuators.items()}
    return Jog(states, message.begin_within)


def decode_degrade(payload: bytes) -> DegradeMessage:
    """Returns the message in a `degrade` payload.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    return parse(payload, DegradeMessage, "degrade")


def decode_fault(payload: bytes) -> FaultMessage:
    """Returns the message in a `fault` payload.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    return parse(payload, FaultMessage, "fault")


def decode_obstacles(payload: bytes, dimension: int) -> Obstacles:
    """Returns the obstacles in an `obstacles` payload, for an arm of 2 or 3 dimensions.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    from hyperbit.controller.obstacles.notation import parse_obstacles  # its kernels take a second to import

    message = parse(payload, ObstaclesMessage, "obstacles", MOST_OBSTACLE_BYTES)
    faults = list[str]()
    obstacles = parse_obstacles(message.regions, dimension, "regions", faults)
    if faults:
        raise Refusal(Reason.INVALID_FIELDS, faults=all_faults(faults))
    return obstacles
