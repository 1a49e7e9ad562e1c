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

from hyperbit.controller.armfile.strict import check
from hyperbit.controller.motion.decoding.destinations import destination, rotation
from hyperbit.controller.motion.trajectory import MOST_POINTS, Trajectory, along, through
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, all_faults

if TYPE_CHECKING:  # its kernels take a second to import; clients that only decode messages need not wait
    from hyperbit.controller.manipulator.manipulator import Manipulator
    from hyperbit.controller.motion.stages.pacing import Pace

MOST_BYTES = 1_000_000
BEGIN_WITHIN = 8.0  # [s] from the arrival of a request to its acceptance; Zenoh's queries end after 10 s
FARTHEST_AHEAD = 86_400.0  # [s]; a stamp in milliseconds would lie centuries ahead

# The bounds exclude infinity and NaN. Greater lengths are mistakes of the unit and overflow when they are squared.
Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
Tolerable = Annotated[float, Meta(ge=1e-9, le=1e6)]
Time = Annotated[float, Meta(ge=0, le=sys.float_info.max)]
PlanningSeconds = Annotated[float, Meta(gt=0, le=60)]
BeginSeconds = Annotated[float, Meta(gt=0, le=86_400)]
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

    With a `path_tolerance` the tip follows the straight lines between the waypoints. `deadline` is the longest time of
    its planning [s]. The goal is refused unless it was accepted within `begin_within` [s] after its arrival.
    """

    waypoints: list[Waypoint]
    id: Id | None = None
    stamp: Time = 0.0
    tolerance: Tolerance = Tolerance()
    path_tolerance: Tolerable | None = None
    deadline: PlanningSeconds | None = None
    begin_within: BeginSeconds | None = None

    @property
    def patience(self) -> float:
        """`begin_within`, or its default: BEGIN_WITHIN beside the time of planning [s]."""
        return BEGIN_WITHIN + (self.deadline or 0.0) if self.begin_within is None else self.begin_within


class Jog(NamedTuple):
    """A decoded jog."""

    states: dict[int, int]  # new state of each actuator, 0 contracted and 1 extended, by index
    patience: float = BEGIN_WITHIN  # longest time from its arrival to its acceptance [s]


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
    """A payload does not decode as a goal. The reason takes a hundred times as long, so it is found when asked for."""

    def __init__(self, payload: bytes) -> None:
        super().__init__(Reason.NOT_UNICODE, what="goal")
        self._payload: bytes | None = payload

    @property
    def reason(self) -> Reason:
        """Why the payload is no goal."""
        self._find()
        return super().reason

    @property
    def facts(self) -> dict[str, str]:
        """The facts as texts."""
        self._find()
        return super().facts

    def _find(self) -> None:
        """Finds the reason at the first call."""
        payload, self._payload = self._payload, None
        if payload is None:
            return
        try:
            parse_strictly(payload)
        except Refusal as refusal:
            self._reason, self._facts = refusal.reason, refusal.facts


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
        byte = f"{payload[error.start]:02x}"
        raise Refusal(Reason.NOT_UTF8, what="goal", byte=error.start, value=byte) from None
    except (ValueError, RecursionError) as error:
        raise Refusal(Reason.NOT_JSON, what="goal", error=str(error)) from None
    if not isinstance(value, dict):
        raise Refusal(Reason.NO_OBJECT, what="goal", fields="`waypoints`")
    if isinstance(value.get("waypoints"), list) and len(value["waypoints"]) > MOST_POINTS:
        raise Refusal(Reason.TOO_MANY_WAYPOINTS, count=len(value["waypoints"]), most=MOST_POINTS)
    try:
        message = msgspec.convert(value, GoalMessage)
    except (
        msgspec.ValidationError,
        RecursionError,
        UnicodeError,
    ):  # the slower check names each fault by its field
        raise refusal_of(value, GoalMessage, "goal") from None
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
                raise Refusal(Reason.NO_DESTINATION, where=f"{where}.position")
            continue
        for name, given in (("position", waypoint.position), ("orientation", waypoint.orientation)):
            if given is not None:
                raise Refusal(Reason.TWO_DESTINATIONS, where=f"{where}.{name}")
        if message.path_tolerance is not None:
            raise Refusal(Reason.LINE_WITH_POSE, where=f"{where}.configuration")


def check_reach(message: GoalMessage, base: Sequence[float], farthest: float, tolerance: float) -> None:
    """Checks the distances of a goal's positions from the base.

    Args:
        message: the goal.
        base: position of the arm's base, shape (dimension,). Positions of another dimension are not checked.
        farthest: greatest distance of the tip from the base.
        tolerance: default tolerance of the position.

    Raises:
        Refusal: a position is farther than the tip can be; the message names the field.
    """
    most = message.tolerance.position or tolerance
    for k, waypoint in enumerate(message.waypoints):
        position = waypoint.position
        if position is None or len(position) != len(base):
            continue
        if (away := math.dist(position, base)) > farthest + most:
            where, numbers = f"waypoints[{k}].position", ", ".join(f"{x:g}" for x in position)
            raise Refusal(Reason.BEYOND_LENGTH, message.id, where=where, position=numbers, away=away, farthest=farthest)


def check_size(size: int) -> None:
    """Checks a payload's size in bytes.

    Raises:
        Refusal: the payload is too large.
    """
    if size > MOST_BYTES:
        raise Refusal(Reason.TOO_LARGE, what="goal", size=size, most=MOST_BYTES)


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


def refusal_of(value: Any, kind: type[Struct], name: str) -> Refusal:
    """Returns the refusal of a value that is no message of a kind, which is called `name`; it names the fields."""
    faults: list[str] = []
    try:
        check(value, kind, faults)
    except RecursionError:
        return Refusal(Reason.NESTED_TOO_DEEPLY, what=name)
    return Refusal(Reason.INVALID_FIELDS, faults=all_faults(faults))


class GoalRules(NamedTuple):
    """What the trajectories of an arm's goals depend on."""

    dimension: int  # number of coordinates of a position, 2 or 3
    tolerance: float  # default tolerance of the position
    angle_tolerance: float  # default tolerance of the orientation [rad]
    pace: Pace  # of the actuators
    # the whole arm, for waypoints that are configurations; None: such waypoints are refused
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
        raise Refusal(Reason.NO_WAYPOINTS)
    dimension, tolerance, angle_tolerance, pace, manipulator = rules
    places, fixed = list[Position](), dict[int, NDArray[np.uint8]]()
    for k, waypoint in enumerate(message.waypoints):
        position: Position = waypoint.position or ()
        if waypoint.configuration is not None:
            position, fixed[k] = destination(waypoint.configuration, manipulator, f"waypoints[{k}].configuration")
        elif len(position) != dimension:
            raise Refusal(
                Reason.WRONG_DIMENSION, where=f"waypoints[{k}].position", count=len(position), dimension=dimension
            )
        elif waypoint.orientation is not None and message.path_tolerance is not None:
            raise Refusal(Reason.LINE_WITH_POSE, where=f"waypoints[{k}].orientation")
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
            earlier = f"waypoints[{k}].t = {before:g}"
            raise Refusal(Reason.TIMES_NOT_INCREASING, where=f"waypoints[{k + 1}]", t=after, earlier=earlier)
        if after - before < shortest - 1e-9:
            apart, needed = f"{after - before:.3g}", f"{shortest:.3g}"
            raise Refusal(
                Reason.TIMES_TOO_CLOSE, where=f"waypoints[{k}] to waypoints[{k + 1}]", apart=apart, needed=needed
            )
    if stamp and stamp + times[-1] < now:
        late = now - stamp - times[-1]
        raise Refusal(Reason.ARRIVED_TOO_LATE, late=f"{late:.3f}")
    ahead = max(stamp - now if stamp else 0.0, 0.0) + times[-1]
    if ahead > FARTHEST_AHEAD:
        raise Refusal(Reason.TOO_FAR_AHEAD, ahead=f"{ahead:.3g}", most=FARTHEST_AHEAD)
