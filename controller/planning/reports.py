"""What is told of one program: feedback at its marks, and its one result."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from controller.manipulator.manipulator import Manipulator
from controller.manipulator.notation import pose
from controller.motion import codes
from controller.motion.jog import STATES
from controller.motion.trajectory import Trajectory
from controller.planning.arm_state import Measured, States
from controller.planning.context import GoalContext, encode_context
from controller.planning.goal_check import UNKNOWN, Verdict, at_the_end, on_the_way, target_of, whereabouts
from controller.planning.messages import Payload
from controller.program import Ended, Travel

STATUS_CODES = {
    "canceled": codes.INVALID_GOAL,
    "replaced": codes.INVALID_GOAL,
    "aborted": codes.PATH_TOLERANCE_VIOLATED,
}


class Report(Protocol):
    """What is told of one program."""

    id: str

    @property
    def context(self) -> bytes:
        """Comes back with the result."""

    @property
    def waypoint(self) -> int | None:
        """The waypoint that the arm moves to or is at; None before the first."""

    @property
    def target(self) -> Payload | None:
        """Position and orientation that the arm moves to or is at, as the goal asks for them; None without such."""

    @property
    def waypoints(self) -> Sequence[Payload]:
        """All waypoints: time, position and orientation, as the goal asks for them."""

    def begun(self, point: int) -> None:
        """Notes that the stages to a point have begun."""

    def settled(
        self, point: int, measured: Measured, switches: int, stages: int, deviation: float | None
    ) -> tuple[Payload | None, Verdict | None]:
        """Returns the feedback of a settled point, if any is told, and a verdict if that ends the goal."""

    def judged(self, measured: Measured) -> Verdict:
        """Returns the verdict on a program whose last mark has settled."""

    def where(self, measured: Measured, travels: Sequence[Travel] = ()) -> Payload:
        """Returns where the arm is measured, and what else the result tells; `travels` are measured ways."""


class GoalReport:
    """What is told of a goal.

    Args:
        manipulator: the whole arm.
        goal: its id.
        trajectory: what it asks for.
    """

    def __init__(self, manipulator: Manipulator, goal: str, trajectory: Trajectory) -> None:
        self.id = goal
        self._manipulator, self._trajectory = manipulator, trajectory
        self._point = -1
        self._stages, self._deviation = 0, 0.0  # since the waypoint before
        self._deviation_known = True

    @property
    def context(self) -> bytes:
        """Comes back with the result."""
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
        """Position and orientation of the point that the arm moves to or is at; the first point before."""
        return self._asked(max(self._point, 0))

    @property
    def waypoints(self) -> Sequence[Payload]:
        """All waypoints: time, position and orientation; of a tip that is corrected, as it was asked for."""
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
    ) -> tuple[Payload | None, Verdict | None]:
        """Returns the feedback of a settled point, if it is a waypoint, and a verdict if that ends the goal."""
        self.begun(point)
        self._stages += stages
        self._deviation_known = self._deviation_known and deviation is not None
        self._deviation = max(self._deviation, deviation or 0.0)
        target = target_of(self._manipulator, self._trajectory, point)
        where = whereabouts(self._manipulator, measured, target)
        told: Payload | None = None
        if not self._trajectory.between(point):
            told = {
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
        return told, None if last else on_the_way(self.id, self._trajectory, point, where)

    def judged(self, measured: Measured) -> Verdict:
        """Returns the verdict on a program whose last mark has settled."""
        target = target_of(self._manipulator, self._trajectory, len(self._trajectory.times) - 1)
        return at_the_end(self.id, target, whereabouts(self._manipulator, measured, target))

    def where(self, measured: Measured, travels: Sequence[Travel] = ()) -> Payload:
        """Returns where the arm is measured, the errors from the point it moved to last, and the bias."""
        target = target_of(self._manipulator, self._trajectory, max(self._point, 0))
        return {**whereabouts(self._manipulator, measured, target), **self._bias}

    @property
    def _bias(self) -> Payload:
        return {} if self._trajectory.bias is None else {"bias": self._trajectory.bias}


class JogReport:
    """What is told of single actuators that were switched.

    Args:
        manipulator: the whole arm.
        name: the id of the result.
        target: actuator states, shape (A,).
        chosen: which actuators the request names, shape (k,).
    """

    def __init__(self, manipulator: Manipulator, name: str, target: States, chosen: list[int]) -> None:
        self.id, self.waypoint, self.target = name, None, None
        self.waypoints: Sequence[Payload] = ()
        self._manipulator, self._target, self._chosen = manipulator, target, chosen

    @property
    def context(self) -> bytes:
        """Comes back with the result."""
        return encode_context(self.id, 1, 0, None, None)

    def begun(self, point: int) -> None:
        """Notes nothing."""

    def settled(
        self, point: int, measured: Measured, switches: int, stages: int, deviation: float | None
    ) -> tuple[Payload | None, Verdict | None]:
        """Returns no feedback."""
        return None, None

    def judged(self, measured: Measured) -> Verdict:
        """Returns whether the actuators are where they were sent."""
        labels, apart = self._manipulator.actuators, measured[self._chosen] != self._target[self._chosen]
        if not apart.any():
            return Verdict("succeeded", codes.SUCCESSFUL, "switched", "holding; the actuators were switched")
        names = ", ".join(labels[k] for k in np.array(self._chosen)[apart])
        message = f"not measured where they were sent: {names}"
        return Verdict("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; {message}")

    def where(self, measured: Measured, travels: Sequence[Travel] = ()) -> Payload:
        """Returns where the arm is measured, and the travel times of the actuators with an end-stop there."""
        labels = self._manipulator.actuators
        told = [{"actuator": labels[t.actuator], "state": STATES[t.state], "seconds": t.seconds} for t in travels]
        return {**whereabouts(self._manipulator, measured, None), "travels": told}


def result(goal: str, verdict: Verdict, switches: int, where: Payload) -> Payload:
    """Returns the payload of a result."""
    told = {"id": goal, "status": verdict.status, "code": verdict.code, "message": verdict.message}
    return {**told, "switches": switches, **where}


def verdict_of(ended: Ended) -> Verdict:
    """Returns the verdict on a program that ended before it was done."""
    return Verdict(ended.status, STATUS_CODES[ended.status], ended.message, "")


def foreign_result(manipulator: Manipulator, ended: Ended, measured: Measured, context: GoalContext) -> Payload:
    """Returns the result of a program that another run of the planner sent."""
    target = context.target
    reached = context.last_mark == ended.mark
    where = whereabouts(manipulator, measured, target if reached else None)
    if ended.status != "done":
        verdict = verdict_of(ended)
    elif target is None:
        verdict = Verdict("succeeded", codes.SUCCESSFUL, "switched", "")
    else:
        verdict = at_the_end(context.id, target, whereabouts(manipulator, measured, target))
    bias = {} if context.bias is None else {"bias": context.bias}
    return result(context.id, verdict, ended.switches, {**(where or UNKNOWN), **bias})
