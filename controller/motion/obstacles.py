"""Obstacles from the network: strict decoding."""

from msgspec import Struct

from controller.motion.goal import refusal
from controller.motion.setpoint import parse
from controller.obstacles.notation import ObstacleList, parse_obstacles
from controller.obstacles.obstacles import Obstacles

MOST_BYTES = 200_000  # 256 obstacles with long names and all digits


class ObstaclesMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of `obstacles`: all obstacles beside those of the arm's file, in the same notation."""

    regions: ObstacleList


def decode(payload: bytes, dimension: int) -> Obstacles:
    """Returns the obstacles in a payload.

    Args:
        payload: JSON.
        dimension: of the arm, 2 or 3.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    message = parse(payload, ObstaclesMessage, "obstacles", MOST_BYTES)
    faults = list[str]()
    regions = parse_obstacles(message.regions, dimension, "regions", faults)
    if faults:
        raise refusal("; ".join(faults[:3]) + (f" (and {len(faults) - 3} more faults)" if len(faults) > 3 else ""))
    return regions
