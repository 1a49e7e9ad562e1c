"""Goals of FollowJointTrajectory as goals of the daemon: for the tip, and for single actuators."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.notation import format_configuration
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.ros2.poses import BadGoal, Fields, Place, orientation, seconds, yaw

INVALID_JOINTS = -2
AXES = ("tip_x", "tip_y", "tip_z")
YAW = "tip_yaw"
NEAR = 0.01  # greatest distance of an actuator's position from 0 or 1
ERASED = -1.0  # a tolerance that there is not
MOST_POINTS = 10_000


class Trajectory(NamedTuple):
    """The part of a goal that both kinds of joints share."""

    joints: tuple[str, ...]
    positions: np.ndarray[tuple[int, int], np.dtype[np.float64]]  # shape (points, joints)
    times: list[float]  # after the stamp [s], shape (points,)
    stamp: float  # UNIX time of the start [s]; 0: at once


def trajectory(goal: Any) -> Trajectory:
    """Returns the points of a control_msgs/action/FollowJointTrajectory_Goal.

    Raises:
        BadGoal: it has no points or joints, a joint twice, positions that do not match the joints, or a number that is
            not finite.
    """
    given = goal.trajectory
    joints = tuple(given.joint_names)
    if not joints:
        raise BadGoal("trajectory.joint_names: none, expected at least one", INVALID_JOINTS)
    if len(set(joints)) < len(joints):
        raise BadGoal(f"trajectory.joint_names: {', '.join(joints[:10])}: a joint occurs twice", INVALID_JOINTS)
    if goal.multi_dof_trajectory.points:
        raise BadGoal("multi_dof_trajectory: not supported; give tip_x, tip_y, ... as joints of trajectory")
    if not 1 <= len(given.points) <= MOST_POINTS:
        raise BadGoal(f"trajectory.points: {len(given.points)}, expected 1 to {MOST_POINTS}")
    for k, point in enumerate(given.points):
        if len(point.positions) != len(joints):
            raise BadGoal(
                f"trajectory.points[{k}].positions: {len(point.positions)}, expected {len(joints)}, as joints"
            )
        if not np.isfinite(point.positions).all():
            raise BadGoal(f"trajectory.points[{k}].positions: a number is not finite")
    positions = np.array([point.positions for point in given.points], dtype=float).reshape(-1, len(joints))
    times = [seconds(point.time_from_start) for point in given.points]
    return Trajectory(joints, positions, times, seconds(given.header.stamp))


def tip_goal(goal: Any, place: Place) -> Fields:
    """Returns the daemon's goal of a trajectory of the tip. Raises BadGoal if the joints are not tip_x, tip_y, ..."""
    found = trajectory(goal)
    axes = AXES[: place.dimension]
    if set(found.joints) - {YAW} != set(axes):
        names = ", ".join((*axes, f"and perhaps {YAW}"))
        raise BadGoal(f"trajectory.joint_names: {', '.join(found.joints[:10])}, expected {names}", INVALID_JOINTS)
    frame = place.frame(goal.trajectory.header.frame_id, "trajectory")
    columns = {name: found.positions[:, k] for k, name in enumerate(found.joints)}
    waypoints = []
    for k, t in enumerate(found.times):
        point = [*(float(columns[name][k]) for name in axes), *([0.0] * (3 - len(axes)))]
        entry: Fields = {"t": t, "position": place.position(frame, point, f"trajectory.points[{k}]")}
        if YAW in columns:
            cos, sin = math.cos(columns[YAW][k]), math.sin(columns[YAW][k])
            turned = frame[:3, :3] @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            entry["orientation"] = orientation(turned, place.dimension)
        waypoints.append(entry)
    return {"waypoints": waypoints, "stamp": found.stamp, **_tolerances(goal, axes, place.metres)}


def actuator_goal(goal: Any, manipulator: Manipulator, states: Sequence[int | None]) -> Fields:
    """Returns the daemon's goal of a trajectory of actuators. Unnamed actuators stay.

    Args:
        goal: of the action; a position is 0 (contracted) or 1 (extended).
        states: present states of the actuators (A,), None where unknown.

    Raises:
        BadGoal: a joint is no actuator, a position is neither 0 nor 1, or the states form no configuration.
    """
    found = trajectory(goal)
    labels = list(manipulator.actuators)
    if unknown := [name for name in found.joints if name not in labels]:
        given = f"{unknown[0][:50]!r} is no actuator"
        raise BadGoal(f"trajectory.joint_names: {given}, expected names such as {labels[0]!r}", INVALID_JOINTS)
    columns = [labels.index(name) for name in found.joints]
    present = list(states)
    waypoints = []
    for k, (row, t) in enumerate(zip(found.positions, found.times, strict=True)):
        if (far := np.abs(row - np.round(row)) > NEAR).any() or (np.abs(row - 0.5) > 0.5 + NEAR).any():
            j = int(np.argmax(far | (np.abs(row - 0.5) > 0.5 + NEAR)))
            raise BadGoal(f"trajectory.points[{k}]: {found.joints[j]} at {row[j]:g}, expected 0 or 1")
        for column, value in zip(columns, row, strict=True):
            present[column] = round(float(value))
        waypoints.append({"t": t, "configuration": _configuration(manipulator, present, f"trajectory.points[{k}]")})
    return {"waypoints": waypoints, "stamp": found.stamp}


def _configuration(manipulator: Manipulator, states: Sequence[int | None], where: str) -> str:
    """Returns the text of the configuration with these actuator states."""
    result, begin = [], 0
    for number, module in enumerate(manipulator.modules, 1):
        own = states[begin : begin + len(module.actuators)]
        begin += len(module.actuators)
        if None in own:
            raise BadGoal(f"{where}: module {number} has an actuator of unknown state; give all of its actuators")
        matches = np.flatnonzero((module.bits == np.array(own, dtype=np.uint8)).all(axis=1))
        if not len(matches):
            raise BadGoal(f"{where}: module {number} has no configuration with its actuators at {own}")
        result.append(int(matches[0]))
    return format_configuration(manipulator, result)


def _tolerances(goal: Any, axes: Sequence[str], metres: float) -> Fields:
    """Returns `tolerance` and `path_tolerance` of the daemon's goal. 0 means the default, and -1 no tolerance.

    `metres` is the length of a unit of the daemon. A position always has a tolerance: that of the arm's file.
    """
    result: Fields = {}
    for where, entries in (("goal_tolerance", goal.goal_tolerance), ("path_tolerance", goal.path_tolerance)):
        if unknown := [it.name for it in entries if it.name not in (*axes, YAW)]:
            names = ", ".join((*axes, YAW))
            raise BadGoal(f"{where}: {unknown[0][:50]!r}, expected joints of the tip: {names}", INVALID_JOINTS)
    positions = _tolerance(goal.goal_tolerance, "goal_tolerance", axes)
    turns = _tolerance(goal.goal_tolerance, "goal_tolerance", (YAW,))
    if any(it.name == YAW and it.position == ERASED for it in goal.goal_tolerance):
        turns = math.pi  # any orientation
    if _tolerance(goal.path_tolerance, "path_tolerance", (YAW,)) is not None:
        raise BadGoal(f"path_tolerance: {YAW}: lines are followed by position only, leave it out")
    tolerance = {} if positions is None else {"position": positions / metres}
    if turns is not None:
        tolerance["orientation"] = turns
    if tolerance:
        result["tolerance"] = tolerance
    if (path := _tolerance(goal.path_tolerance, "path_tolerance", axes)) is not None:
        result["path_tolerance"] = path / metres
    return result


def _tolerance(entries: Sequence[Any], where: str, names: Sequence[str]) -> float | None:
    """Returns the least position tolerance of the named joints."""
    values = [float(it.position) for it in entries if it.name in names]
    if any(not math.isfinite(value) or (value < 0 and value != ERASED) for value in values):
        words = "a tolerance is negative or not finite; 0 means that of the arm's file, -1 none"
        raise BadGoal(f"{where}: {words}")
    return min((value for value in values if value > 0), default=None)


def time_tolerance(goal: Any) -> float | None:
    """Returns how long after the time of its last point a goal may end [s]; None: at any time."""
    allowed = seconds(goal.goal_time_tolerance)
    if allowed < 0 and allowed != ERASED:
        raise BadGoal(f"goal_time_tolerance: {allowed:g} s is negative; 0 and -1 mean that the goal may take any time")
    return allowed if allowed > 0 else None


def tip_positions(told: Pose | None, joints: Sequence[str], place: Place) -> list[float]:
    """Returns the values of joints of the tip [m, rad] of a pose of the daemon; NaN if it is not known."""
    if told is None:
        return [math.nan] * len(joints)
    known = dict(zip(AXES[: place.dimension], place.coordinates(told), strict=False)) | {YAW: yaw(told)}
    return [known.get(name, math.nan) for name in joints]
