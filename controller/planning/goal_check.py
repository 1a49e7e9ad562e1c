"""Checks of a goal against measured states: the measured tip, the goal reached or missed, the path left."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.frames import Frame, angle_between
from controller.manipulator.manipulator import Manipulator
from controller.manipulator.notation import format_configuration, pose
from controller.motion import codes
from controller.motion.trajectory import Trajectory
from controller.planning.arm_state import Measured
from controller.planning.messages import Payload

UNKNOWN: Payload = {
    "configuration": None,
    "position": None,
    "orientation": None,
    "error": None,
    "orientation_error": None,
}


class Outcome(NamedTuple):
    """The end of a goal: status, code and message of its result, and a sentence on what the arm does then."""

    status: str
    code: int
    message: str
    sentence: str


@dataclass(frozen=True, eq=False)
class Target:
    """The target at one point of a goal.

    Attributes:
        position: of the tip in the world, shape (dimension,).
        tolerance: greatest distance from the position.
        rotation: of the tip in the world, shape (3, 3); None: any orientation serves.
        angle_tolerance: greatest angle from the rotation [rad].
        configuration: that the arm must have, as text; None: any.
    """

    position: NDArray[np.float64]
    tolerance: float
    rotation: NDArray[np.float64] | None = None
    angle_tolerance: float = np.inf
    configuration: str | None = None

    def angle(self, tip: Frame) -> float | None:
        """Returns the angle between a tip (4, 4) and the target [rad]; None if any orientation serves."""
        if self.rotation is None:
            return None
        frame = np.eye(4)
        frame[:3, :3] = self.rotation
        return angle_between(tip, frame)


def target_of(manipulator: Manipulator, trajectory: Trajectory, point: int) -> Target:
    """Returns the target at a point of a trajectory."""
    turns, fixed = float(trajectory.turns[point]), trajectory.fixed.get(point)
    return Target(
        trajectory.positions[point],
        float(trajectory.tolerances[point]),
        trajectory.rotations[point] if turns < np.inf else None,
        turns,
        None if fixed is None else format_configuration(manipulator, manipulator.configuration(fixed)),
    )


def measured_tip(manipulator: Manipulator, measured: Measured) -> Frame | None:
    """Returns the tip's frame (4, 4) for measured actuator states (A,); None if they spell no configuration."""
    try:
        return manipulator.tip(manipulator.configuration(measured))
    except ValueError:
        return None


def measured_pose(manipulator: Manipulator, measured: Measured, target: Target | None) -> Payload:
    """Returns configuration and pose of measured actuator states (A,), and the errors from a target.

    All are None if the states spell no configuration; the errors are None without a target.
    """
    tip = measured_tip(manipulator, measured)
    if tip is None:
        return UNKNOWN
    error = None if target is None else float(np.linalg.norm(tip[: len(target.position), 3] - target.position))
    return {
        "configuration": format_configuration(manipulator, manipulator.configuration(measured)),
        **pose(manipulator, tip),
        "error": error,
        "orientation_error": None if target is None else target.angle(tip),
    }


def check_last_waypoint(goal: str, target: Target, where: Payload) -> Outcome:
    """Returns the outcome of a goal whose last waypoint has settled; `where` is its measured_pose."""
    error, angle = where["error"], where["orientation_error"]
    if target.configuration is not None:
        reached = where["configuration"] == target.configuration
        measured = where["configuration"] or "unknown"
        message = f"the measured configuration is {measured}, not {target.configuration}"
    else:
        reached = error is not None and error <= target.tolerance
        reached = reached and (angle is None or angle <= target.angle_tolerance)
        away = "unknown" if error is None else f"{error:.4f} from the last waypoint"
        message = f"the measured tip is {away}, tolerance {target.tolerance:g}"
        if angle is not None:
            tolerances = f"tolerances {target.tolerance:g} and {target.angle_tolerance:g}"
            message = f"the measured tip is {away} and turned {angle:.4f} rad, {tolerances}"
    if reached:
        return Outcome("succeeded", codes.SUCCESSFUL, "reached", f"holding; goal {goal} was reached")
    return Outcome("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; goal {goal} was missed: {message}")


def check_path(goal: str, trajectory: Trajectory, point: int, where: Payload) -> Outcome | None:
    """Returns the outcome of a goal whose measured tip has left its path at a point before the last; otherwise None."""
    error = where["error"]
    if trajectory.path_tolerance is None:
        return None
    between = trajectory.between(point)
    tolerance = trajectory.tolerances[point] if between else trajectory.path_tolerance
    if error is not None and error <= tolerance:
        return None
    away = "unknown" if error is None else f"{error:.4f} from the moving target"
    at = f"after waypoints[{trajectory.last(point)}] the measured tip is {away}"
    message = f"{at}, path_tolerance {trajectory.path_tolerance:g}"
    return Outcome("aborted", codes.PATH_TOLERANCE_VIOLATED, message, f"holding; goal {goal} left its path: {message}")


def collision_outcome(goal: str, words: str) -> Outcome:
    """Returns the outcome of a goal whose remaining stages would collide."""
    message = f"the planned motion would collide: {words}; the arm holds"
    sentence = f"holding; goal {goal} was aborted: the planned motion would collide: {words}"
    return Outcome("aborted", codes.PATH_TOLERANCE_VIOLATED, message, sentence)
