"""What the boards measured says of a goal: where the tip is, and whether the goal is reached or its path left."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.daemon.events import Payload
from controller.daemon.execution import Execution
from controller.daemon.state import measured_tip, written
from controller.manipulator.frames import angle_between
from controller.manipulator.manipulator import Manipulator
from controller.manipulator.notation import pose
from controller.motion import codes

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


def whereabouts(manipulator: Manipulator, measured: NDArray[np.int8], execution: Execution) -> Payload:
    """Returns configuration and pose of measured actuator states (A,), and the error from the point last switched to.

    All are None where the states tell no configuration.
    """
    tip = measured_tip(manipulator, measured)
    if tip is None:
        return UNKNOWN
    trajectory, point = execution.plan.trajectory, max(execution.point, 0)
    wanted = trajectory.positions[point]
    return {
        "configuration": written(manipulator, measured),
        **pose(manipulator, tip),
        "error": float(np.linalg.norm(tip[: len(wanted), 3] - wanted)),
        "orientation_error": angle_between(tip, trajectory.goal(point)) if trajectory.turns[point] < np.inf else None,
    }


def bias(execution: Execution) -> Payload:
    """Returns what the goal is corrected by, where it may be."""
    correction = execution.plan.trajectory.bias
    return {} if correction is None else {"bias": correction}


def feedback(execution: Execution, where: Payload) -> Payload:
    """Returns what is told of the waypoint last switched to when it is settled."""
    return {
        "id": execution.goal.id,
        "waypoint": execution.waypoint,
        "waypoints": len(execution.plan.trajectory.waypoints),
        "switches": execution.switches,
        "stages": execution.stages,
        "excursion": execution.excursion,
        **where,
        **bias(execution),
    }


def at_the_end(execution: Execution, where: Payload) -> Verdict:
    """Judges a goal whose last waypoint is settled."""
    goal, trajectory = execution.goal.id, execution.plan.trajectory
    error, tolerance = where["error"], float(trajectory.tolerances[-1])
    angle, turn = where["orientation_error"], float(trajectory.turns[-1])
    if error is not None and error <= tolerance and (angle is None or angle <= turn):
        return Verdict("succeeded", codes.SUCCESSFUL, "reached", f"holding; goal {goal} was reached")
    away = "unknown" if error is None else f"{error:.4f} from the last waypoint"
    message = f"the measured tip is {away}, tolerance {tolerance:g}"
    if angle is not None:
        message = f"the measured tip is {away} and turned {angle:.4f} rad, tolerances {tolerance:g} and {turn:g}"
    return Verdict("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; goal {goal} was missed: {message}")


def on_the_way(execution: Execution, where: Payload) -> Verdict | None:
    """Judges a goal that follows lines, None as long as the tip has not left them."""
    goal, trajectory, error = execution.goal.id, execution.plan.trajectory, where["error"]
    if trajectory.path_tolerance is None:
        return None
    between = trajectory.between(execution.point)
    tolerance = trajectory.tolerances[execution.point] if between else trajectory.path_tolerance
    if error is not None and error <= tolerance:
        return None
    away = "unknown" if error is None else f"{error:.4f} from the line's point"
    at = f"after waypoints[{execution.waypoint}] the measured tip is {away}"
    message = f"{at}, path_tolerance {trajectory.path_tolerance:g}"
    return Verdict("aborted", codes.PATH_TOLERANCE_VIOLATED, message, f"holding; goal {goal} left its path: {message}")
