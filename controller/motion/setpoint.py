"""Setpoints as they stream in over the network: strict decoding of one."""

import json
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from controller.motion.codes import Refusal
from controller.motion.goal import Coordinate, Time, Tolerance, once, refusal
from controller.strict import check

MOST_BYTES = 10_000


class SetpointMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of a setpoint; `stamp` is UNIX seconds at which the goal was there, 0 meaning on arrival."""

    position: Annotated[list[Coordinate], Meta(min_length=2, max_length=3)]
    stamp: Time = 0.0
    tolerance: Tolerance = Tolerance()


@dataclass(frozen=True, eq=False)
class Setpoint:
    """Where a moving goal was at one time.

    Attributes:
        position: of the goal in the world, shape (dimension,).
        stamp: when it was there by the sender's clock [UNIX s], None: on arrival.
        tolerance: greatest distance of the tip from the goal.
    """

    position: NDArray[np.float64]
    stamp: float | None
    tolerance: float


def decode(payload: bytes, dimension: int, tolerance: float) -> Setpoint:
    """Returns the setpoint in a payload.

    Args:
        payload: JSON.
        dimension: number of coordinates of a position, 2 or 3.
        tolerance: of the position, where the setpoint has none.

    Raises:
        Refusal: what is wrong, by field; nothing else, whatever the bytes.
    """
    message = parse(payload)
    if len(message.position) != dimension:
        raise refusal(f"position: {len(message.position)} coordinates, this arm's goals have {dimension}")
    if message.tolerance.orientation is not None:
        raise refusal("tolerance.orientation: this arm follows positions only, leave it out")
    return Setpoint(
        position=np.array(message.position),
        stamp=message.stamp or None,
        tolerance=message.tolerance.position or tolerance,
    )


def parse(payload: bytes) -> SetpointMessage:
    """Returns the message in a payload.

    Raises:
        Refusal: too large, not UTF-8, not JSON, or not a setpoint.
    """
    if len(payload) > MOST_BYTES:
        raise refusal(f"setpoint of {len(payload)} bytes, at most {MOST_BYTES} are taken")
    try:
        value: Any = json.loads(payload.decode("utf-8"), object_pairs_hook=once)
    except UnicodeDecodeError as error:
        raise refusal(f"setpoint is not UTF-8: byte {error.start} is 0x{payload[error.start]:02x}") from None
    except (ValueError, RecursionError) as error:
        raise refusal(f"setpoint is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise refusal("setpoint: an object with `position` is needed")
    try:
        return msgspec.convert(value, SetpointMessage)
    except (msgspec.ValidationError, RecursionError, UnicodeError):  # the slower check tells what, by field
        raise _refusal_of(value) from None


def _refusal_of(value: Any) -> Refusal:
    """Returns the refusal of a value that is no setpoint."""
    faults: list[str] = []
    try:
        check(value, SetpointMessage, faults)
    except RecursionError:
        faults = ["setpoint is nested too deeply"]
    return refusal("; ".join(faults[:3]) + (f" (and {len(faults) - 3} more faults)" if len(faults) > 3 else ""))
