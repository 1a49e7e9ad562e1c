"""The reports on one program: feedback at its marks, and its one result."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from controller.manipulator.locked import STATES
from controller.manipulator.manipulator import Manipulator
from controller.manipulator.notation import pose
from controller.motion import codes
from controller.motion.trajectory import Trajectory
from controller.planning.arm_state import Measured, States
from controller.planning.context import GoalContext, encode_context
from controller.planning.goal_check import UNKNOWN, Outcome, check_last_waypoint, check_path, measured_pose, target_of
from controller.planning.messages import Payload
from controller.program import Ended, Travel

STATUS_CODES = {
    "canceled": codes.INVALID_GOAL,
    "replaced": codes.INVALID_GOAL,
    "aborted": codes.PATH_TOLERANCE_VIOLATED,
}


class Report(Protocol):
    """The reports on one program."""

    id: str

    @property
    def context(self) -> bytes:
        """The context that comes back with the result."""

    @property
    def waypoint(self) -> int | None:
        """The waypoint that the arm moves to or is at; None before the first."""

    @property
    def target(self) -> Payload | None:
        """Position and orientation that the goal gives for the arm's present point; None for a jog."""

    @property
    def waypoints(self) -> Sequence[Payload]:
        """All waypoints: time, position and orientation as the goal gives them."""

    def begun(self, point: int) -> None:
        """Notes that the stages to a point have begun."""

    def settled(
        self, point: int, measured: Measured, switches: int, stages: int, deviation: float | None
    ) -> tuple[Payload | None, Outcome | None]:
        """Returns the feedback of a settled point, if there is any, and an outcome if the goal ends there."""

    def final_outcome(self, measured: Measured) -> Outcome:
        """Returns the outcome of a program whose last mark has settled."""

    def where(self, measured: Measured, travels: Sequence[Travel] = ()) -> Payload:
        """Returns the measured pose and other fields of the result; `travels` are measured travels."""


class GoalReport:
    """The reports on a goal.

    Args:
        manipulator: the whole arm.
        goal: its id.
        trajectory: of the goal.
    """

    def __init__(self, manipulator: Manipulator, goal: str, trajectory: Trajectory) -> None:
        self.id = goal
        self._manipulator, self._trajectory = manipulator, trajectory
        self._point = -1
        self._stages, self._deviation = 0, 0.0  # since the waypoint before
        self._deviation_known = True

    @property
    def context(self) -> bytes:
        """The context that comes back with the result."""
        last = len(self._trajectory.times) - 1
        target = target_of(self._manipulator, self._trajectory, last)
        return encode_context(self.id, len(self._trajectory.waypoints), last, target, self._trajectory.bias)

    @property
    def waypoint(self) -> int | None:
        """The waypoint that the arm moves to or is at; None before the first."""
        last = self._trajectory.last(self._point)
        return last if last >= 0 else None

    @property
    def target(self) -> Payload:
        """Position and orientation of the present point; of the first point before that has begun."""
        return self._asked(max(self._point, 0))

    @property
    def waypoints(self) -> Sequence[Payload]:
        """All waypoints: time, position and orientation as the goal gave them, not corrected by the tip bias."""
        return [{"t": self._trajectory.times[k], **self._asked(k)} for k in self._trajectory.waypoints.tolist()]

    def _asked(self, point: int) -> Payload:
        """Returns position and orientation of a point; the orientation is None if any serves."""
        trajectory = self._trajectory
        position = trajectory.positions[point]
        if trajectory.bias is not None and point not in trajectory.fixed:
            position = position + trajectory.bias
        frame = np.eye(4)
        frame[:3, :3] = trajectory.rotations[point]
        turned = trajectory.turns[point] < np.inf
        return {
            "position": position.tolist(),
            "orientation": pose(self._manipulator, frame)["orientation"] if turned else None,
        }

    def begun(self, point: int) -> None:
        """Notes that the stages to a point have begun."""
        self._point = max(point, self._point)

    def settled(
        self, point: int, measured: Measured, switches: int, stages: int, deviation: float | None
    ) -> tuple[Payload | None, Outcome | None]:
        """Returns the feedback if the settled point is a waypoint, and an outcome if the tip has left its path."""
        self.begun(point)
        self._stages += stages
        self._deviation_known = self._deviation_known and deviation is not None
        self._deviation = max(self._deviation, deviation or 0.0)
        target = target_of(self._manipulator, self._trajectory, point)
        where = measured_pose(self._manipulator, measured, target)
        feedback: Payload | None = None
        if not self._trajectory.between(point):
            feedback = {
                "id": self.id,
                "waypoint": self._trajectory.last(point),
                "waypoints": len(self._trajectory.waypoints),
                "switches": switches,
                "stages": self._stages,
                "excursion": self._deviation if self._deviation_known else None,
                **where,
                **self._bias,
            }
            self._stages, self._deviation, self._deviation_known = 0, 0.0, True
        last = point == len(self._trajectory.times) - 1
        return feedback, None if last else check_path(self.id, self._trajectory, point, where)

    def final_outcome(self, measured: Measured) -> Outcome:
        """Returns the outcome of a program whose last mark has settled."""
        target = target_of(self._manipulator, self._trajectory, len(self._trajectory.times) - 1)
        return check_last_waypoint(self.id, target, measured_pose(self._manipulator, measured, target))

    def where(self, measured: Measured, travels: Sequence[Travel] = ()) -> Payload:
        """Returns the measured pose, the errors from the present point, and the bias."""
        target = target_of(self._manipulator, self._trajectory, max(self._point, 0))
        return {**measured_pose(self._manipulator, measured, target), **self._bias}

    @property
    def _bias(self) -> Payload:
        return {} if self._trajectory.bias is None else {"bias": self._trajectory.bias}


class JogReport:
    """The reports on a jog.

    Args:
        manipulator: the whole arm.
        name: id of the result.
        target: actuator states, shape (A,).
        chosen: the actuators that the request names, shape (k,).
    """

    def __init__(self, manipulator: Manipulator, name: str, target: States, chosen: list[int]) -> None:
        self.id, self.waypoint, self.target = name, None, None
        self.waypoints: Sequence[Payload] = ()
        self._manipulator, self._target, self._chosen = manipulator, target, chosen

    @property
    def context(self) -> bytes:
        """The context that comes back with the result."""
        return encode_context(self.id, 1, 0, None, None)

    def begun(self, point: int) -> None:
        """Does nothing."""

    def settled(
        self, point: int, measured: Measured, switches: int, stages: int, deviation: float | None
    ) -> tuple[Payload | None, Outcome | None]:
        """Returns no feedback."""
        return None, None

    def final_outcome(self, measured: Measured) -> Outcome:
        """Returns whether the actuators are measured in their new states, as an outcome."""
        labels, apart = self._manipulator.actuators, measured[self._chosen] != self._target[self._chosen]
        if not apart.any():
            return Outcome("succeeded", codes.SUCCESSFUL, "switched", "holding; the actuators were switched")
        names = ", ".join(labels[k] for k in np.array(self._chosen)[apart])
        message = f"not measured in the requested state: {names}"
        return Outcome("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; {message}")

    def where(self, measured: Measured, travels: Sequence[Travel] = ()) -> Payload:
        """Returns the measured pose, and the travel times of the actuators with an end-stop."""
        labels = self._manipulator.actuators
        shown = [{"actuator": labels[t.actuator], "state": STATES[t.state], "seconds": t.seconds} for t in travels]
        return {**measured_pose(self._manipulator, measured, None), "travels": shown}


def result(goal: str, outcome: Outcome, switches: int, where: Payload) -> Payload:
    """Returns the payload of a result."""
    fields = {"id": goal, "status": outcome.status, "code": outcome.code, "message": outcome.message}
    return {**fields, "switches": switches, **where}


def outcome_of(ended: Ended) -> Outcome:
    """Returns the outcome of a program that ended before it was done."""
    return Outcome(ended.status, STATUS_CODES[ended.status], ended.message, "")


def foreign_result(manipulator: Manipulator, ended: Ended, measured: Measured, context: GoalContext) -> Payload:
    """Returns the result of a program that an earlier planner process sent."""
    target = context.target
    reached = context.last_mark == ended.mark
    where = measured_pose(manipulator, measured, target if reached else None)
    if ended.status != "done":
        outcome = outcome_of(ended)
    elif target is None:
        outcome = Outcome("succeeded", codes.SUCCESSFUL, "switched", "")
    else:
        outcome = check_last_waypoint(context.id, target, measured_pose(manipulator, measured, target))
    bias = {} if context.bias is None else {"bias": context.bias}
    return result(context.id, outcome, ended.switches, {**(where or UNKNOWN), **bias})
