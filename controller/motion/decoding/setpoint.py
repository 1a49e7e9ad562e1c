"""Set-points from the network: strict decoding, shared with the other small messages."""

import json
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from hyperbit.controller.motion.decoding.goal import Coordinate, Time, Tolerance, once, refusal_of
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

S = TypeVar("S", bound=Struct)

MOST_BYTES = 10_000


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
    """Returns the set-point in a payload.

    Args:
        payload: JSON.
        dimension: number of coordinates of a position, 2 or 3.
        tolerance: default tolerance of the position.

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


def parse(payload: bytes, kind: type[S], name: str, most: int = MOST_BYTES) -> S:
    """Returns the message of a kind in a payload.

    Args:
        payload: JSON.
        kind: of the message.
        name: of the message in refusals.
        most: greatest size [bytes].

    Raises:
        Refusal: too large, not UTF-8, not JSON, or not a message of this kind.
    """
    if len(payload) > most:
        raise Refusal(Reason.TOO_LARGE, what=name, size=len(payload), most=most)
    try:
        value: Any = json.loads(payload.decode("utf-8"), object_pairs_hook=once)
    except UnicodeDecodeError as error:
        byte = f"{payload[error.start]:02x}"
        raise Refusal(Reason.NOT_UTF8, what=name, byte=error.start, value=byte) from None
    except (ValueError, RecursionError) as error:
        raise Refusal(Reason.NOT_JSON, what=name, error=str(error)) from None
    if not isinstance(value, dict):
        needed = " and ".join(f"`{field.name}`" for field in msgspec.structs.fields(kind) if field.required)
        raise Refusal(Reason.NO_OBJECT, what=name, fields=needed)
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, RecursionError, UnicodeError):  # the slower check names each fault
        raise refusal_of(value, kind, name) from None
