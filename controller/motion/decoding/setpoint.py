"""Set-points from the network."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from hyperbit.controller.armfile.fields import Coordinate
from hyperbit.controller.motion.decoding.goal import Time, Tolerance
from hyperbit.controller.motion.decoding.payloads import parse
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal


class SetpointMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of a set-point; `stamp` is the time of the position [UNIX s], 0 means on arrival."""

    position: Annotated[list[Coordinate], Meta(min_length=2, max_length=3)]
    stamp: Time = 0.0
    tolerance: Tolerance = Tolerance()


@dataclass(frozen=True, eq=False)
class TrackedSetpoint:
    """The position of a moving goal at one time."""

    position: NDArray[np.float64]  # of the goal in the world, shape (dimension,)
    stamp: float | None  # time of the position by the sender's clock [UNIX s]; None: on arrival
    tolerance: float  # greatest distance of the tip from the goal


def decode(payload: bytes, dimension: int, tolerance: float) -> TrackedSetpoint:
    """Returns the set-point in a JSON payload; positions have `dimension` coordinates, 2 or 3.

    `tolerance` is the default of the position.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    message = parse(payload, SetpointMessage, "setpoint")
    if len(message.position) != dimension:
        raise Refusal(Reason.WRONG_DIMENSION, where="position", count=len(message.position), dimension=dimension)
    if message.tolerance.orientation is not None:
        raise Refusal(Reason.NO_ORIENTATION)
    return TrackedSetpoint(
        position=np.array(message.position),
        stamp=message.stamp or None,
        tolerance=message.tolerance.position or tolerance,
    )
