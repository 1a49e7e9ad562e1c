"""Goals as they come over the network: strict decoding into a trajectory."""

import json
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from controller.motion.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP, Refusal
from controller.strict import check

MOST_BYTES = 1_000_000
MOST_WAYPOINTS = 10_000
FARTHEST_AHEAD = 86_400.0  # [s]; a stamp in milliseconds would lie centuries ahead

Positive = Annotated[float, Meta(gt=0)]


class Waypoint(Struct, forbid_unknown_fields=True, frozen=True):
    """Where the tip is to be settled, `t` seconds after the stamp."""

    position: Annotated[list[float], Meta(min_length=2, max_length=3)]
    t: Annotated[float, Meta(ge=0)] = 0.0
    orientation: float | list[float] | None = None


class Tolerance(Struct, forbid_unknown_fields=True, frozen=True):
    """How near is good enough."""

    position: Positive | None = None
    orientation: Positive | None = None


class GoalMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of a goal; `stamp` is UNIX seconds of t = 0, 0 meaning on arrival."""

    waypoints: list[Waypoint]
    id: Annotated[str, Meta(min_length=1, max_length=128)] | None = None
    stamp: Annotated[float, Meta(ge=0)] = 0.0
    tolerance: Tolerance = Tolerance()


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A goal that has passed decoding.

    Attributes:
        id: the sender's, or None.
        times: UNIX seconds at which the tip is to be settled, shape (n,), increasing.
        positions: of the tip in the world, shape (n, dimension).
        tolerance: greatest distance of the tip from a waypoint.
    """

    id: str | None
    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    tolerance: float


def decode(payload: bytes, dimension: int, tolerance: float, shortest: float, now: float) -> Trajectory:
    """Returns the trajectory that a payload asks for.

    Args:
        payload: JSON as design says, UTF-8.
        dimension: number of coordinates of a position, 2 or 3.
        tolerance: of the position, where the goal has none.
        shortest: least time between two waypoints that the actuators can keep [s].
        now: time of arrival, UNIX seconds.

    Raises:
        Refusal: what is wrong, by field; nothing else, whatever the bytes.
    """
    message = parse(payload)
    if not message.waypoints:
        raise Refusal(INVALID_GOAL, "waypoints: empty; at least one is needed")
    for k, waypoint in enumerate(message.waypoints):
        if len(waypoint.position) != dimension:
            raise Refusal(
                INVALID_GOAL,
                f"waypoints[{k}].position: {len(waypoint.position)} coordinates, this arm's goals have {dimension}",
            )
        if waypoint.orientation is not None:
            raise Refusal(INVALID_GOAL, f"waypoints[{k}].orientation: this arm takes positions only, leave it out")
    relative = np.array([waypoint.t for waypoint in message.waypoints])
    check_times(relative, message.stamp, shortest, now)
    return Trajectory(
        id=message.id,
        times=(message.stamp or now) + relative,
        positions=np.array([waypoint.position for waypoint in message.waypoints], dtype=float),
        tolerance=message.tolerance.position or tolerance,
    )


def parse(payload: bytes) -> GoalMessage:
    """Returns the message in a payload.

    Raises:
        Refusal: too large, not UTF-8, not JSON, or not a goal.
    """
    if len(payload) > MOST_BYTES:
        raise Refusal(INVALID_GOAL, f"goal of {len(payload)} bytes, at most {MOST_BYTES} are taken")
    try:
        value: Any = json.loads(payload.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise Refusal(INVALID_GOAL, f"goal is not UTF-8: byte {error.start} is 0x{payload[error.start]:02x}") from None
    except (ValueError, RecursionError) as error:
        raise Refusal(INVALID_GOAL, f"goal is not JSON: {error}") from None
    if isinstance(value, dict) and isinstance(value.get("waypoints"), list):
        count = len(value["waypoints"])
        if count > MOST_WAYPOINTS:
            raise Refusal(INVALID_GOAL, f"waypoints: {count}, at most {MOST_WAYPOINTS} are taken")
    faults: list[str] = []
    message = check(value, GoalMessage, faults)
    if message is None:
        more = f" (and {len(faults) - 3} more faults)" if len(faults) > 3 else ""
        raise Refusal(INVALID_GOAL, "; ".join(faults[:3]) + more)
    return message


def check_times(relative: NDArray[np.float64], stamp: float, shortest: float, now: float) -> None:
    """Checks the waypoints' times.

    Raises:
        Refusal: they do not increase, follow faster than the actuators, lie in the past, or too far ahead.
    """
    steps = np.diff(relative)
    if (steps <= 0).any():
        k = int(np.argmax(steps <= 0))
        raise Refusal(
            INVALID_GOAL,
            f"waypoints[{k + 1}].t: {relative[k + 1]:g} does not come after waypoints[{k}].t = {relative[k]:g}",
        )
    if (steps < shortest - 1e-9).any():
        k = int(np.argmax(steps < shortest - 1e-9))
        raise Refusal(
            INVALID_GOAL,
            f"waypoints[{k}] to waypoints[{k + 1}]: {steps[k]:.3g} s apart, the actuators need {shortest:.3g} s",
        )
    if stamp and stamp + relative[-1] < now:
        late = now - stamp - relative[-1]
        raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: the trajectory ended {late:.3f} s before it arrived")
    ahead = max(stamp - now if stamp else 0.0, 0.0) + float(relative[-1])
    if ahead > FARTHEST_AHEAD:
        raise Refusal(
            INVALID_GOAL,
            f"stamp: the trajectory would end {ahead:.3g} s from now, at most {FARTHEST_AHEAD:g} s are taken;"
            " stamps are UNIX seconds",
        )
