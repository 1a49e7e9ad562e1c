"""Goals from the network: strict decoding into a message, then into a trajectory."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from controller.armfile.strict import check
from controller.motion.codes import GOAL_TOLERANCE_VIOLATED, INVALID_GOAL, OLD_HEADER_TIMESTAMP, Refusal
from controller.motion.decoding.destinations import destination, rotation
from controller.motion.trajectory import MOST_POINTS, Trajectory, along, through

if TYPE_CHECKING:  # its kernels take a second to import; clients that only decode messages need not wait
    from controller.manipulator.manipulator import Manipulator
    from controller.motion.stages.pacing import Pace

MOST_BYTES = 1_000_000
LONGEST_SENTENCE = 1_000
FARTHEST_AHEAD = 86_400.0  # [s]; a stamp in milliseconds would lie centuries ahead

# The bounds exclude infinity and NaN. Greater lengths are mistakes of the unit and overflow when they are squared.
Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
Tolerable = Annotated[float, Meta(ge=1e-9, le=1e6)]
Time = Annotated[float, Meta(ge=0, le=sys.float_info.max)]
# An angle, or one component of a quaternion.
Turn = Annotated[float, Meta(ge=-1e6, le=1e6)]
Position = Sequence[float] | NDArray[np.float64]
Id = Annotated[str, Meta(pattern=r"^[ -~]{1,128}\Z")]  # it is written to logs, a database and systemd's status


class Waypoint(Struct, forbid_unknown_fields=True, frozen=True):
    """A point at which the arm must have settled `t` seconds after the stamp.

    It has either a position of the tip, with an optional orientation, or a configuration in the notation of `fk`.
    """

    position: Annotated[list[Coordinate], Meta(min_length=2, max_length=3)] | None = None
    t: Time = 0.0
    orientation: Turn | list[Turn] | None = None
    configuration: Annotated[str, Meta(max_length=100_000)] | None = None


class Tolerance(Struct, forbid_unknown_fields=True, frozen=True):
    """Tolerances of a waypoint: of the position, and of the orientation [rad]."""

    position: Tolerable | None = None
    orientation: Tolerable | None = None


class GoalMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of a goal; `stamp` is t = 0 in UNIX seconds, 0 means now.

    With a `path_tolerance` the tip follows the straight lines between the waypoints.
    """

    waypoints: list[Waypoint]
    id: Id | None = None
    stamp: Time = 0.0
    tolerance: Tolerance = Tolerance()
    path_tolerance: Tolerable | None = None


_NAMES = [b'"%s"' % name.encode() for kind in (GoalMessage, Waypoint, Tolerance) for name in kind.__struct_fields__]
_decode = msgspec.json.Decoder(GoalMessage).decode


def parse(payload: bytes) -> GoalMessage:
    """Returns the message in a payload.

    Raises:
        Refusal: too large, not UTF-8, not JSON, or not a goal. No other exception is raised.
    """
    check_size(len(payload))
    message = parse_quickly(payload)
    if message is None:
        if decoded(payload) is None:
            raise Undecodable(payload)
        message = parse_strictly(payload)
    check_destinations(message)
    return message


class Undecodable(Refusal):
    """A payload does not decode as a goal. The reason takes a hundred times as long, so only `str` looks for it."""

    def __init__(self, payload: bytes) -> None:
        super().__init__(INVALID_GOAL, "")
        self._payload = payload

    def __str__(self) -> str:
        try:
            parse_strictly(self._payload)
        except Refusal as refusal:
            return str(refusal)
        return "goal: a text in it is no Unicode"


def parse_quickly(payload: bytes) -> GoalMessage | None:
    """Returns the message of a goal in which each name occurs at most once; None for all others."""
    if b"\\" in payload or any(payload.count(name) > 1 for name in _NAMES):
        return None  # a name may occur twice in one object, which msgspec does not detect
    return decoded(payload)


def decoded(payload: bytes) -> GoalMessage | None:
    """Returns the message in a payload, without the checks of `parse`; None if there is none."""
    try:
        return _decode(payload)
    except (msgspec.DecodeError, RecursionError, UnicodeError):
        return None


def parse_strictly(payload: bytes) -> GoalMessage:
    """Returns the message in a payload as `parse` does, without the check of destinations."""
    try:
        value: Any = json.loads(payload.decode("utf-8"), object_pairs_hook=once)
    except UnicodeDecodeError as error:
        raise refusal(f"goal is not UTF-8: byte {error.start} is 0x{payload[error.start]:02x}") from None
    except (ValueError, RecursionError) as error:
        raise refusal(f"goal is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise refusal("goal: an object with `waypoints` is needed")
    if isinstance(value.get("waypoints"), list) and len(value["waypoints"]) > MOST_POINTS:
        raise refusal(f"waypoints: {len(value['waypoints'])}, at most {MOST_POINTS} are accepted")
    try:
        message = msgspec.convert(value, GoalMessage)
    except (
        msgspec.ValidationError,
        RecursionError,
        UnicodeError,
    ):  # the slower check names each fault by its field
        raise refusal(faults_of(value)) from None
    return message


def check_destinations(message: GoalMessage) -> None:
    """Checks that each waypoint has either a position or a configuration.

    Raises:
        Refusal: a waypoint has neither or both, or a configuration with an orientation or a path tolerance.
    """
    for k, waypoint in enumerate(message.waypoints):
        where = f"waypoints[{k}]"
        if waypoint.configuration is None:
            if waypoint.position is None:
                raise refusal(f"{where}.position: required, but missing; a `configuration` may replace it")
            continue
        for name, given in (("position", waypoint.position), ("orientation", waypoint.orientation)):
            if given is not None:
                raise refusal(f"{where}.{name}: a configuration already determines it, leave out one of them")
        if message.path_tolerance is not None:
            raise refusal(f"{where}.configuration: lines are followed by position only, leave out path_tolerance")


def check_reach(message: GoalMessage, manipulator: Manipulator, farthest: float, tolerance: float) -> None:
    """Checks the distances of a goal's positions from the base.

    Args:
        message: the goal.
        manipulator: the whole arm.
        farthest: greatest distance of the tip from the base.
        tolerance: default tolerance of the position.

    Raises:
        Refusal: a position is farther than the tip can be; the message names the field.
    """
    base, most = manipulator.base[: manipulator.dimension, 3].tolist(), message.tolerance.position or tolerance
    for k, waypoint in enumerate(message.waypoints):
        position = waypoint.position
        if position is None or len(position) != len(base):
            continue
        if (away := math.dist(position, base)) > farthest + most:
            where = f"waypoints[{k}].position: ({', '.join(f'{x:g}' for x in position)}) is out of reach"
            words = f"{where}: {away:g} from the base, and no tip is farther from it than {farthest:g}"
            raise Refusal(GOAL_TOLERANCE_VIOLATED, words, message.id)


def check_size(size: int) -> None:
    """Checks a payload's size in bytes.

    Raises:
        Refusal: the payload is too large.
    """
    if size > MOST_BYTES:
        raise refusal(f"goal of {size} bytes, at most {MOST_BYTES} are accepted")


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Returns the object of name-value pairs; json.loads would silently keep the last of equal names.

    Raises:
        ValueError: a name occurs twice.
    """
    fields = dict(pairs)
    if len(fields) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise ValueError(f"{twice!r} occurs twice in one object")
    return fields


def faults_of(value: Any) -> str:
    """Returns the first three faults of a value that is no goal, named by field."""
    faults: list[str] = []
    try:
        check(value, GoalMessage, faults)
    except RecursionError:
        return "goal is nested too deeply"
    more = f" (and {len(faults) - 3} more faults)" if len(faults) > 3 else ""
    return "; ".join(faults[:3]) + more


def refusal(message: str) -> Refusal:
    """Returns the refusal of an invalid goal; the message is cut at LONGEST_SENTENCE and made printable."""
    if len(message) > LONGEST_SENTENCE:
        message = message[:LONGEST_SENTENCE] + "..."
    return Refusal(INVALID_GOAL, message.encode("utf-8", "backslashreplace").decode())


class GoalRules(NamedTuple):
    """What the trajectories of an arm's goals depend on.

    Attributes:
        dimension: number of coordinates of a position, 2 or 3.
        tolerance: default tolerance of the position.
        angle_tolerance: default tolerance of the orientation [rad].
        pace: of the actuators.
        manipulator: the whole arm, for waypoints that are configurations; None: such waypoints are refused.
    """

    dimension: int
    tolerance: float
    angle_tolerance: float
    pace: Pace
    manipulator: Manipulator | None = None


def schedule(message: GoalMessage, rules: GoalRules, now: float) -> Trajectory:
    """Returns the trajectory of a goal.

    Args:
        message: the goal.
        rules: of the arm.
        now: time of arrival [UNIX s].

    Raises:
        Refusal: the goal is invalid; the message names the field.
    """
    if not message.waypoints:
        raise refusal("waypoints: empty; at least one is needed")
    dimension, tolerance, angle_tolerance, pace, manipulator = rules
    places, fixed = list[Position](), dict[int, NDArray[np.uint8]]()
    for k, waypoint in enumerate(message.waypoints):
        position: Position = waypoint.position or ()
        if waypoint.configuration is not None:
            position, fixed[k] = destination(waypoint.configuration, manipulator, f"waypoints[{k}].configuration")
        elif len(position) != dimension:
            raise refusal(f"waypoints[{k}].position: {len(position)} coordinates, this arm's goals have {dimension}")
        elif waypoint.orientation is not None and message.path_tolerance is not None:
            raise refusal(f"waypoints[{k}].orientation: lines are followed by position only, leave out path_tolerance")
        places.append(position)
    moments = [waypoint.t for waypoint in message.waypoints]
    check_times(moments, message.stamp, pace.shortest, now)
    positions, times = np.array(places, dtype=np.float64), np.array(moments)
    own, stamp = message.tolerance.position or tolerance, message.stamp or None
    if message.path_tolerance is None:
        angle = message.tolerance.orientation or angle_tolerance
        wanted = [waypoint.orientation for waypoint in message.waypoints]
        turns = rotations = None
        if any(orientation is not None for orientation in wanted):
            turns = np.array([math.inf if value is None or angle >= math.pi else angle for value in wanted])
            rotations = np.array([rotation(v, dimension, f"waypoints[{k}].orientation") for k, v in enumerate(wanted)])
        trajectory = through(times, positions, own, stamp, rotations, turns)
        return replace(trajectory, fixed=fixed) if fixed else trajectory
    return along(times, positions, own, message.path_tolerance, pace, stamp)


def check_times(times: Sequence[float], stamp: float, shortest: float, now: float) -> None:
    """Checks the waypoints' times.

    Raises:
        Refusal: times do not increase, are closer than the actuators allow, lie in the past, or too far ahead.
    """
    for k, (before, after) in enumerate(pairwise(times)):
        if after <= before:
            raise refusal(f"waypoints[{k + 1}].t: {after:g} does not come after waypoints[{k}].t = {before:g}")
        if after - before < shortest - 1e-9:
            apart = f"{after - before:.3g} s apart, the actuators need {shortest:.3g} s"
            raise refusal(f"waypoints[{k}] to waypoints[{k + 1}]: {apart}")
    if stamp and stamp + times[-1] < now:
        late = now - stamp - times[-1]
        raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: the trajectory ended {late:.3f} s before it arrived")
    ahead = max(stamp - now if stamp else 0.0, 0.0) + times[-1]
    if ahead > FARTHEST_AHEAD:
        raise refusal(
            f"stamp: the trajectory would end {ahead:.3g} s from now, at most {FARTHEST_AHEAD:g} s are accepted;"
            " stamps are UNIX seconds"
        )
