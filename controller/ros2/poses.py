"""Poses of ROS 2 as waypoints of goals, and back."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.ros2.wire.session import LATEST, SECOND

Fields = dict[str, Any]

OLDEST = 5.0  # [s], greatest age, and greatest lead, of a pose's stamp
FARTHEST = 1e6  # greatest coordinate, as in the daemon; greater ones overflow in a frame
LENGTH_ERROR = 0.01  # greatest error of the length of a unit quaternion


class BadGoal(ValueError):
    """A ROS 2 message is no goal of this arm. `code` is of FollowJointTrajectory."""

    def __init__(self, message: str, code: int = -1) -> None:
        super().__init__(message)
        self.code = code


class Place(NamedTuple):
    """The world of the arm. Lengths are metres in ROS 2, and of the arm's file in the daemon's messages."""

    world: str  # name of the world's frame
    arm: str  # its base has the frame "<arm>/0"
    base: Frame  # in the world, shape (4, 4) [m]
    dimension: int
    metres: float = 1.0  # of a unit of the arm's file

    def frame(self, name: str, where: str) -> Frame:
        """Returns a named frame (4, 4) in the world; "" is the world. Raises BadGoal unless it is world or base."""
        if name in ("", self.world):
            return np.eye(4)
        if name == f"{self.arm}/0":
            return self.base
        raise BadGoal(f"{where}.header.frame_id: {name[:100]!r}, expected {self.world!r} or '{self.arm}/0'")

    def position(self, frame: Frame, point: Sequence[float], where: str) -> list[float]:
        """Returns the world coordinates, in the daemon's unit, of a point (3,) [m] in a frame (4, 4) [m].

        Raises BadGoal if one is too great.
        """
        if any(abs(x) > FARTHEST for x in point):
            raise BadGoal(f"{where}: {max(point, key=abs):g}, expected at most {FARTHEST:g}")
        found: list[float] = ((frame @ [*point, 1.0])[: self.dimension] / self.metres).tolist()
        return found

    def pose(self, told: Pose) -> Fields:
        """Converts a pose of the daemon."""
        turned = told.orientation
        if turned is None:
            turned = [0.0, 0.0, 0.0, 1.0]
        elif isinstance(turned, float | int):
            turned = [0.0, 0.0, math.sin(turned / 2), math.cos(turned / 2)]
        axes = dict(zip("xyz", self.coordinates(told), strict=True))
        return {"position": axes, "orientation": dict(zip("xyzw", map(float, turned), strict=True))}

    def coordinates(self, told: Pose) -> list[float]:
        """Returns the position (3,) of a pose of the daemon [m]."""
        return [float(x) * self.metres for x in (*told.position, 0.0)[:3]]


def seconds(stamp: Any) -> float:
    """Returns a time or duration of ROS 2 [s]."""
    return float(stamp.sec + stamp.nanosec / SECOND)


def time_of(stamp: float) -> Fields:
    """Returns a UNIX time [s] as a time of ROS 2."""
    nanoseconds = min(round(stamp * SECOND), LATEST)
    return {"sec": nanoseconds // SECOND, "nanosec": nanoseconds % SECOND}


def check_stamp(stamp: float, where: str, now: float) -> None:
    """Raises BadGoal if a stamp is too old, or in the future; 0 is always valid. `now` is the UNIX time [s]."""
    age = now - stamp
    if stamp != 0 and abs(age) > OLDEST:
        when = f"{age:.1f} s old" if age > 0 else f"{-age:.1f} s in the future"
        raise BadGoal(f"{where}.header.stamp: {when}, expected at most {OLDEST:g} s, or 0", -3)


def waypoint(message: Any, place: Place, where: str, *, oriented: bool) -> Fields:
    """Returns the waypoint of a geometry_msgs/msg/PoseStamped.

    Args:
        where: name of the message, for errors.
        oriented: whether its orientation counts.

    Raises:
        BadGoal: a number is not finite, the quaternion has no unit length, or the frame is unknown.
    """
    frame = place.frame(message.header.frame_id, where)
    point = finite(message.pose.position, "xyz", f"{where}.pose.position")
    result: Fields = {"position": place.position(frame, point, where)}
    if oriented:
        turned = frame[:3, :3] @ rotation(finite(message.pose.orientation, "xyzw", f"{where}.pose.orientation"), where)
        result["orientation"] = orientation(turned, place.dimension)
    return result


def finite(holder: Any, names: str, where: str) -> list[float]:
    """Returns fields of a message as numbers. Raises BadGoal if a number is NaN or infinite."""
    values = [float(getattr(holder, name)) for name in names]
    for name, value in zip(names, values, strict=True):
        if not math.isfinite(value):
            raise BadGoal(f"{where}.{name}: {value}, expected a finite number")
    return values


def rotation(quaternion: Sequence[float], where: str) -> Frame:
    """Returns the rotation (3, 3) of a quaternion x, y, z, w. Raises BadGoal if its length is not 1."""
    length = math.hypot(*quaternion)
    if abs(length - 1.0) > LENGTH_ERROR:
        raise BadGoal(f"{where}.pose.orientation: a quaternion of length {length:.3g}, expected a unit quaternion")
    x, y, z, w = np.array(quaternion) / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def orientation(turned: Frame, dimension: int) -> Any:
    """Returns the orientation of a waypoint: an angle in the plane, a quaternion x, y, z, w in space."""
    if dimension == 2:
        return math.atan2(turned[1, 0], turned[0, 0])
    from hyperbit.controller.manipulator.frames import quaternion

    whole = np.eye(4)
    whole[:3, :3] = turned
    return quaternion(whole).tolist()


def yaw(told: Pose) -> float:
    """Returns the angle about z of a pose of the daemon [rad]; NaN without orientation."""
    turned = told.orientation
    if turned is None:
        return math.nan
    if isinstance(turned, float | int):
        return float(turned)
    x, y, z, w = turned
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
