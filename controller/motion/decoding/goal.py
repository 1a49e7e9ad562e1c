"""Goals from the network: strict decoding into a message, then into a trajectory.

Functions import the kernels, which take a second to import. Clients that only decode messages need not wait for them.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from hyperbit.controller.armfile.choices import LARGEST
from hyperbit.controller.armfile.fields import Angle, AngleTolerance, Coordinate
from hyperbit.controller.armfile.strict import UNIT
from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.motion.decoding.payloads import check_size, converted, object_in
from hyperbit.controller.motion.trajectory import FINEST, MOST_POINTS, Trajectory, along, count_parts, through
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, leg, nth_waypoint

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator
    from hyperbit.controller.motion.stages.pacing import Pace

MOST_BYTES = 1_000_000
BEGIN_WITHIN = 8.0  # [s] from the arrival of a request to its acceptance; Zenoh's queries end after 10 s
LONGEST = 200  # characters of a quoted message
FARTHEST_AHEAD = 86_400.0  # [s]; a stamp in milliseconds would lie centuries ahead

# The bounds exclude infinity and NaN.
Tolerable = Annotated[float, Meta(ge=1e-9, le=LARGEST)]
Time = Annotated[float, Meta(ge=0, le=sys.float_info.max)]
PlanningSeconds = Annotated[float, Meta(gt=0, le=60)]
BeginSeconds = Annotated[float, Meta(gt=0, le=86_400)]
Position = Sequence[float] | NDArray[np.float64]
Id = Annotated[str, Meta(pattern=r"^[ -~]{1,128}\Z")]  # it is written to logs, a database and systemd's status


class Waypoint(Struct, forbid_unknown_fields=True, frozen=True):
    """A point at which the arm must have settled `t` seconds after the stamp.

    If no waypoint of a goal has a `t` above 0, the goal takes as long as the arm needs at most.
    It has either a position of the tip, with an optional orientation, or a configuration in the notation of `fk`.
    """

    position: Annotated[list[Coordinate], Meta(min_length=2, max_length=3)] | None = None
    t: Time = 0.0
    orientation: Angle | list[Coordinate] | None = None
    configuration: Annotated[str, Meta(max_length=100_000)] | None = None


class Tolerance(Struct, forbid_unknown_fields=True, frozen=True):
    """Tolerances of a waypoint: of the position, and of the orientation [rad]."""

    position: Tolerable | None = None
    orientation: AngleTolerance | None = None


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


def parse(payload: bytes) -> GoalMessage:
    """Returns the message in a payload.

    Raises:
        Refusal: too large, not UTF-8, not JSON, or not a goal. No other exception is raised.
    """
    check_size(payload, "goal", MOST_BYTES)
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
        self._find()
        return super().reason

    @property
    def facts(self) -> dict[str, str]:
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
        return decode(payload, GoalMessage)
    except Unreadable:
        return None


def parse_strictly(payload: bytes) -> GoalMessage:
    """Returns the message in a payload as `parse` does, without the check of destinations."""
    value = object_in(payload, GoalMessage, "goal")
    if isinstance(value.get("waypoints"), list) and len(value["waypoints"]) > MOST_POINTS:
        raise Refusal(Reason.TOO_MANY_WAYPOINTS, count=len(value["waypoints"]), most=MOST_POINTS)
    return converted(value, GoalMessage, "goal")


def check_destinations(message: GoalMessage) -> None:
    """Checks that each waypoint has either a position or a configuration.

    Raises:
        Refusal: a waypoint has neither or both, or a configuration with an orientation or a path tolerance.
    """
    for k, waypoint in enumerate(message.waypoints):
        if waypoint.configuration is None:
            if waypoint.position is None:
                raise Refusal(Reason.NO_DESTINATION, where=nth_waypoint(k, "position"))
            continue
        for name, given in (("position", waypoint.position), ("orientation", waypoint.orientation)):
            if given is not None:
                raise Refusal(Reason.TWO_DESTINATIONS, where=nth_waypoint(k, name))
        if message.path_tolerance is not None:
            raise Refusal(Reason.LINE_WITH_POSE, where=nth_waypoint(k, "configuration"))


def check_reach(message: GoalMessage, base: Sequence[float], farthest: float, tolerance: float) -> None:
    """Checks the distances of a goal's positions from the arm's base (dimension,).

    The tip is at most `farthest` from the base. `tolerance` is the default of the position. Positions of another
    dimension are not checked.

    Raises:
        Refusal: a position is farther than the tip can be, or every tip is within a tolerance; the message names the
            field.
    """
    own = {"tolerance.position": message.tolerance.position, "path_tolerance": message.path_tolerance}
    for name, given in own.items():
        if given is not None and given > 2.0 * farthest:
            words = f"{name}: {given:g}, but all tips are within {2.0 * farthest:.4g} of each other; check its unit"
            raise Refusal(Reason.INVALID_FIELDS, message.id, faults=words)
    most = message.tolerance.position or tolerance
    for k, waypoint in enumerate(message.waypoints):
        position = waypoint.position
        if position is None or len(position) != len(base):
            continue
        if (away := math.dist(position, base)) > farthest + most:
            where, numbers = nth_waypoint(k, "position"), ", ".join(f"{x:g}" for x in position)
            raise Refusal(Reason.BEYOND_LENGTH, message.id, where=where, position=numbers, away=away, farthest=farthest)


class GoalRules(NamedTuple):
    """What the trajectories of an arm's goals depend on."""

    dimension: int  # number of coordinates of a position, 2 or 3
    tolerance: float  # default tolerance of the position
    angle_tolerance: float  # default tolerance of the orientation [rad]
    pace: Pace  # of the actuators
    # the whole arm, for waypoints that are configurations; None: such waypoints are refused
    manipulator: Manipulator | None = None


def schedule(message: GoalMessage, rules: GoalRules, now: float) -> Trajectory:
    """Returns the trajectory of a goal that arrives `now` [UNIX s].

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
            position, fixed[k] = destination(waypoint.configuration, manipulator, nth_waypoint(k, "configuration"))
        elif len(position) != dimension:
            raise Refusal(
                Reason.WRONG_DIMENSION, where=nth_waypoint(k, "position"), count=len(position), dimension=dimension
            )
        elif waypoint.orientation is not None and message.path_tolerance is not None:
            raise Refusal(Reason.LINE_WITH_POSE, where=nth_waypoint(k, "orientation"))
        places.append(position)
    positions, moments = np.array(places, dtype=np.float64), [waypoint.t for waypoint in message.waypoints]
    if not any(moments):
        moments = ample_times(positions, message.path_tolerance, rules).tolist()
    check_times(moments, message.stamp, pace.shortest, now)
    times = np.array(moments)
    own, stamp = message.tolerance.position or tolerance, message.stamp or None
    if message.path_tolerance is None:
        angle = message.tolerance.orientation or angle_tolerance
        wanted = [waypoint.orientation for waypoint in message.waypoints]
        turns = rotations = None
        if any(orientation is not None for orientation in wanted):
            turns = np.array([math.inf if value is None or angle >= math.pi else angle for value in wanted])
            rotations = np.array([rotation(v, dimension, nth_waypoint(k, "orientation")) for k, v in enumerate(wanted)])
        trajectory = through(times, positions, own, stamp, rotations, turns)
        return replace(trajectory, fixed=fixed) if fixed else trajectory
    return along(times, positions, own, message.path_tolerance, pace, stamp)


def ample_times(positions: NDArray[np.float64], path_tolerance: float | None, rules: GoalRules) -> NDArray[np.float64]:
    """Returns times (m,) [s] for waypoints (m, dimension) without times, enough for the switches between them."""
    ample = rules.pace.ample(0 if rules.manipulator is None else len(rules.manipulator.actuators))
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    parts = np.ones(len(lengths)) if path_tolerance is None else count_parts(lengths, path_tolerance / FINEST)
    return np.concatenate([[0.0], np.cumsum(ample * parts)])


def destination(
    text: str, manipulator: Manipulator | None, where: str
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Returns the tip's position (dimension,) and the actuator states (A,) of a configuration.

    Raises:
        Refusal: the text is no configuration of this arm.
    """
    from hyperbit.controller.manipulator.notation import parse_configuration

    if manipulator is None:
        raise Refusal(Reason.POSITIONS_ONLY, where=where)
    try:
        configuration = parse_configuration(manipulator, text)
    except ValueError as error:
        raise Refusal(Reason.NO_CONFIGURATION, where=where, error=str(error)[:LONGEST]) from None
    tip = manipulator.tip(configuration)
    return tip[: manipulator.dimension, 3], manipulator.actuator_states(configuration)


def rotation(orientation: float | list[float] | None, dimension: int, where: str) -> NDArray[np.float64]:
    """Returns the rotation (3, 3) of an orientation; the identity if it is absent.

    Raises:
        Refusal: a planar arm needs an angle, a spatial arm a unit quaternion.
    """
    from hyperbit.controller.manipulator import frames

    if orientation is None:
        return np.eye(3)
    if dimension == 2:
        if isinstance(orientation, list):
            raise Refusal(Reason.NO_ANGLE, where=where, count=len(orientation))
        return frames.planar(0.0, 0.0, orientation)[:3, :3]
    length = math.hypot(*orientation) if isinstance(orientation, list) and len(orientation) == 4 else 0.0
    if not isinstance(orientation, list) or abs(length - 1.0) > UNIT:
        got = f"one of length {length:.4g}" if length else f"{json.dumps(orientation)[:60]}"
        raise Refusal(Reason.NO_QUATERNION, where=where, got=got)
    return frames.spatial((0.0, 0.0, 0.0), orientation)[:3, :3]


def check_times(times: Sequence[float], stamp: float, shortest: float, now: float) -> None:
    """Checks the waypoints' times.

    Raises:
        Refusal: times do not increase, are closer than the actuators allow, lie in the past, or too far ahead.
    """
    for k, (before, after) in enumerate(pairwise(times)):
        if after <= before:
            earlier = f"{before:g} of {nth_waypoint(k)}"
            raise Refusal(Reason.TIMES_NOT_INCREASING, where=nth_waypoint(k + 1, "t"), t=after, earlier=earlier)
        if after - before < shortest - 1e-9:
            apart, needed = f"{after - before:.3g}", f"{shortest:.3g}"
            raise Refusal(Reason.TIMES_TOO_CLOSE, where=leg(k), apart=apart, needed=needed)
    if stamp and stamp + times[-1] < now:
        late = now - stamp - times[-1]
        raise Refusal(Reason.ARRIVED_TOO_LATE, late=f"{late:.3f}")
    ahead = max(stamp - now if stamp else 0.0, 0.0) + times[-1]
    if ahead > FARTHEST_AHEAD:
        raise Refusal(Reason.TOO_FAR_AHEAD, ahead=f"{ahead:.3g}", most=FARTHEST_AHEAD)
