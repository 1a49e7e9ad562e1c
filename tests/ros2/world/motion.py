"""Which motion a message of ROS 2 asks for. tests/ros2/test_goals has the rules of single poses and trajectories."""

from typing import Any, NamedTuple

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.ros2.poses import BadGoal, Place, check_stamp, seconds, waypoint
from hyperbit.controller.ros2.trajectories import MOST_POINTS, actuator_goal, tip_goal

Positions = list[list[float]]  # one a waypoint


class Arm(NamedTuple):
    """`oriented`: whether the orientation of topics counts."""

    place: Place
    manipulator: Manipulator
    oriented: bool


def motion_of(kind: str, message: Any, arm: Arm, now: float) -> Positions:
    """Returns the positions of a goal_pose, goal_path, setpoint, plan, tip or actuators; a configuration has none.

    Raises BadGoal if the message may not move the arm. `now` is the UNIX time [s].
    """
    poses = [message]
    match kind:
        case "tip":
            return [it["position"] for it in tip_goal(message.goal, arm.place)["waypoints"]]
        case "actuators":
            contracted = [0] * len(arm.manipulator.actuators)
            return [[] for _ in actuator_goal(message.goal, arm.manipulator, contracted)["waypoints"]]
        case "plan":
            poses = [message.goal]
        case "goal_path":
            poses = message.poses
            if not 1 <= len(poses) <= MOST_POINTS:
                raise BadGoal("number of poses")
            arm.place.frame(message.header.frame_id, kind)
            check_stamp(seconds(poses[0].header.stamp), kind, now)
    if kind in ("goal_pose", "goal_path"):
        check_stamp(seconds(message.header.stamp), kind, now)
    oriented = arm.oriented and kind != "setpoint"
    return [waypoint(it, arm.place, kind, oriented=oriented)["position"] for it in poses]


def time_limit(goal: Any) -> tuple[float, float] | None:
    """Returns a goal's stamp [UNIX s], and how long after it the goal must end [s]; None: there is no limit."""
    allowed = seconds(goal.goal_time_tolerance)
    if allowed <= 0 or not goal.trajectory.points:
        return None
    return seconds(goal.trajectory.header.stamp), seconds(goal.trajectory.points[-1].time_from_start) + allowed
