"""Which motion a message of ROS 2 asks for: the rules of the bridge's page, decided a second time."""

import math
from typing import Any, NamedTuple

STAMP_LIMIT = 5.0  # [s]
MOST_POINTS = 10_000
Positions = list[list[float]]  # one a waypoint


class Invalid(Exception):
    """A message breaks a rule, and may not move the arm."""


class Arm(NamedTuple):
    """`oriented`: whether the orientation of topics counts. The base of the arm is the world's origin."""

    frames: tuple[str, ...]
    axes: tuple[str, ...]
    actuators: tuple[str, ...]
    oriented: bool


def motion_of(kind: str, message: Any, arm: Arm, now: float) -> Positions:
    """Returns the positions of a goal_pose, goal_path, setpoint, plan, tip or actuators. Raises Invalid.

    `now` is the UNIX time [s].
    """
    match kind:
        case "goal_pose":
            check_stamp(message.header.stamp, now)
            return [position(message, arm, oriented=arm.oriented)]
        case "setpoint":
            return [position(message, arm, oriented=False)]
        case "plan":
            return [position(message.goal, arm, oriented=arm.oriented)]
        case "goal_path":
            check(message.header.frame_id in ("", *arm.frames), "frame")
            check(1 <= len(message.poses) <= MOST_POINTS, "number of poses")
            check_stamp(message.header.stamp, now)
            check_stamp(message.poses[0].header.stamp, now)
            return [position(it, arm, oriented=arm.oriented) for it in message.poses]
        case _:
            return trajectory(message.goal.trajectory, arm, tip=kind == "tip")


def position(stamped: Any, arm: Arm, *, oriented: bool) -> list[float]:
    check(stamped.header.frame_id in ("", *arm.frames), "frame")
    place, turn = stamped.pose.position, stamped.pose.orientation
    turned = [turn.x, turn.y, turn.z, turn.w]
    check(all(map(math.isfinite, [place.x, place.y, place.z, *(turned if oriented else ())])), "number")
    check(not oriented or abs(math.hypot(*turned) - 1) <= 0.01, "quaternion")
    return [place.x, place.y, place.z][: len(arm.axes)]


def trajectory(given: Any, arm: Arm, *, tip: bool) -> Positions:
    joints, points = list(given.joint_names), [it.positions.tolist() for it in given.points]
    check(len(set(joints)) == len(joints) and 1 <= len(points) <= MOST_POINTS, "number of joints or points")
    check(all(len(point) == len(joints) and all(map(math.isfinite, point)) for point in points), "positions")
    if tip:
        check(given.header.frame_id in ("", *arm.frames), "frame")
        check(set(joints) - {"tip_yaw"} == set(arm.axes), "joints")
        return [[point[joints.index(axis)] for axis in arm.axes] for point in points]
    check(set(joints) <= set(arm.actuators), "joints")
    check(all(min(abs(it), abs(it - 1)) <= 0.01 + 1e-12 for point in points for it in point), "states")
    return points


def time_limit(goal: Any) -> tuple[float, float] | None:
    """Returns a goal's stamp [UNIX s], and how long after it the goal must end [s]; None: there is no limit."""
    allowed = seconds(goal.goal_time_tolerance)
    if allowed <= 0 or not goal.trajectory.points:
        return None
    return seconds(goal.trajectory.header.stamp), seconds(goal.trajectory.points[-1].time_from_start) + allowed


def check_stamp(stamp: Any, now: float) -> None:
    at = seconds(stamp)
    check(at == 0 or abs(now - at) <= STAMP_LIMIT, "stamp")


def seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec / 1e9)


def check(holds: bool, what: str) -> None:
    if not holds:
        raise Invalid(what)
