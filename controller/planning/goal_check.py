"""What the measured states say of a goal: where the tip is, and whether the goal is reached or its path left."""

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


class Verdict(NamedTuple):
    """The end of a goal: its result's status, code and message, and a sentence on what the arm does then."""

    status: str
    code: int
    message: str
    sentence: str


@dataclass(frozen=True, eq=False)
class Target:
    """What one point of a goal asks for.

    Attributes:
        position: of the tip in the world, shape (dimension,).
        tolerance: greatest distance from it.
        rotation: of the tip in the world, shape (3, 3); None: any orientation serves.
        angle_tolerance: greatest angle from it [rad].
        configuration: that the arm must be in, as text; None: any that brings the tip there.
    """

    position: NDArray[np.float64]
    tolerance: float
    rotation: NDArray[np.float64] | None = None
    angle_tolerance: float = np.inf
    configuration: str | None = None

    def angle(self, tip: Frame) -> float | None:
        """Returns the angle between the orientations of a tip (4, 4) and of the target [rad]; None: any serves."""
        if self.rotation is None:
            return None
        frame = np.eye(4)
        frame[:3, :3] = self.rotation
        return angle_between(tip, frame)


def target_of(manipulator: Manipulator, trajectory: Trajectory, point: int) -> Target:
    """Returns what a point of a trajectory asks for."""
    turns, fixed = float(trajectory.turns[point]), trajectory.fixed.get(point)
    return Target(
        trajectory.positions[point],
        float(trajectory.tolerances[point]),
        trajectory.rotations[point] if turns < np.inf else None,
        turns,
        None if fixed is None else format_configuration(manipulator, manipulator.configuration(fixed)),
    )


def measured_tip(manipulator: Manipulator, measured: Measured) -> Frame | None:
    """Returns the tip's frame (4, 4) from measured actuator states (A,); None if they spell no configuration."""
    try:
        return manipulator.tip(manipulator.configuration(measured))
    except ValueError:
        return None


def whereabouts(manipulator: Manipulator, measured: Measured, target: Target | None) -> Payload:
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


def at_the_end(goal: str, target: Target, where: Payload) -> Verdict:
    """Judges a goal whose last waypoint, the target, has settled; `where`: see whereabouts."""
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
        return Verdict("succeeded", codes.SUCCESSFUL, "reached", f"holding; goal {goal} was reached")
    return Verdict("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; goal {goal} was missed: {message}")


def on_the_way(goal: str, trajectory: Trajectory, point: int, where: Payload) -> Verdict | None:
    """Judges a goal that follows lines at a point before its last; None as long as the tip has not left them."""
    error = where["error"]
    if trajectory.path_tolerance is None:
        return None
    between = trajectory.between(point)
    tolerance = trajectory.tolerances[point] if between else trajectory.path_tolerance
    if error is not None and error <= tolerance:
        return None
    away = "unknown" if error is None else f"{error:.4f} from the line's point"
    at = f"after waypoints[{trajectory.last(point)}] the measured tip is {away}"
    message = f"{at}, path_tolerance {trajectory.path_tolerance:g}"
    return Verdict("aborted", codes.PATH_TOLERANCE_VIOLATED, message, f"holding; goal {goal} left its path: {message}")


def touching(goal: str, words: str) -> Verdict:
    """Judges a goal that would touch something on its way."""
    message = f"on the way that was planned, {words}; the arm holds"
    sentence = f"holding; goal {goal} was aborted: on the way that was planned, {words}"
    return Verdict("aborted", codes.PATH_TOLERANCE_VIOLATED, message, sentence)
