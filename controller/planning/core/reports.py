"""The reports on one program: feedback at its marks, and its one result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from controller.manipulator.locked import STATES
from controller.manipulator.notation import format_configuration, pose
from controller.motion import codes
from controller.motion.feed import Proof
from controller.motion.targets import Target, measured_pose
from controller.motion.trajectory import Trajectory
from controller.planning.core.arm import Measured
from controller.planning.core.context import Context, encode_context, with_target
from controller.planning.core.events import Payload
from controller.program import Ended, Settled

if TYPE_CHECKING:
    from controller.manipulator.manipulator import Manipulator

STATUS_CODES = {
    "canceled": codes.INVALID_GOAL,
    "replaced": codes.INVALID_GOAL,
    "aborted": codes.PATH_TOLERANCE_VIOLATED,
    "lost": codes.PATH_TOLERANCE_VIOLATED,
}


class Outcome(NamedTuple):
    """The end of a goal: status, code and message of its result, and a sentence on what the arm does then."""

    status: str
    code: int
    message: str
    sentence: str = ""


class GoalReport:
    """The reports on a goal.

    Attributes:
        id: of the goal.
        trajectory: of the goal.
        count: number of waypoints.

    Args:
        manipulator: the whole arm.
        goal: its id.
        trajectory: of the goal.
    """

    def __init__(self, manipulator: Manipulator, goal: str, trajectory: Trajectory) -> None:
        self.id, self.trajectory, self.count = goal, trajectory, len(trajectory.waypoints)
        self._manipulator = manipulator
        self._point = -1
        self._stages, self._deviation = 0, 0.0  # since the waypoint before
        self._deviation_known = True

    def context(self, sent: float, proof: Proof | None) -> bytes:
        """Returns the context that comes back with the result."""
        last, bias = len(self.trajectory.times) - 1, self.trajectory.bias
        context = Context(
            self.id,
            len(self.trajectory.waypoints),
            last,
            bias=None if bias is None else bias.tolist(),
            sent=sent,
            proof=proof,
        )
        return encode_context(with_target(context, self._target(last)))

    @property
    def waypoint(self) -> int | None:
        """The waypoint that the arm moves to or is at; None before the first."""
        last = self.trajectory.last(self._point)
        return last if last >= 0 else None

    @property
    def target(self) -> Payload:
        """Position and orientation of the present point; of the first point before that has begun."""
        return self._asked(max(self._point, 0))

    @property
    def waypoints(self) -> Sequence[Payload]:
        """All waypoints: time, position and orientation as the goal gave them, not corrected by the tip bias."""
        return [{"t": self.trajectory.times[k], **self._asked(k)} for k in self.trajectory.waypoints.tolist()]

    @property
    def present(self) -> Target:
        """The target at the present point."""
        return self._target(max(self._point, 0))

    def begun(self, point: int) -> None:
        """Notes that the stages to a point have begun."""
        self._point = max(point, self._point)

    def settled(self, message: Settled, measured: Measured, deviation: float | None) -> Payload | None:
        """Returns the feedback of a settled point, None if it is no waypoint; `deviation` is of its transition."""
        point, trajectory = message.mark, self.trajectory
        self._stages += message.stages
        self._deviation_known = self._deviation_known and deviation is not None
        self._deviation = max(self._deviation, deviation or 0.0)
        if trajectory.between(point):
            return None
        feedback = {
            "id": self.id,
            "waypoint": trajectory.last(point),
            "waypoints": len(trajectory.waypoints),
            "switches": message.switches,
            "stages": self._stages,
            "excursion": self._deviation if self._deviation_known else None,
            **measured_pose(self._manipulator, measured, self._target(point)),
            **({} if trajectory.bias is None else {"bias": trajectory.bias}),
        }
        self._stages, self._deviation, self._deviation_known = 0, 0.0, True
        return feedback

    def left_path(self, point: int, measured: Measured) -> Outcome | None:
        """Returns the outcome of a goal whose measured tip has left its path at a settled point; otherwise None."""
        trajectory = self.trajectory
        if trajectory.path_tolerance is None or point == len(trajectory.times) - 1:
            return None
        error = measured_pose(self._manipulator, measured, self._target(point))["error"]
        tolerance = trajectory.tolerances[point] if trajectory.between(point) else trajectory.path_tolerance
        if error is not None and error <= tolerance:
            return None
        away = "unknown" if error is None else f"{error:.4f} from the moving target"
        at = f"after waypoints[{trajectory.last(point)}] the measured tip is {away}"
        message = f"{at}, path_tolerance {trajectory.path_tolerance:g}"
        sentence = f"holding; goal {self.id} left its path: {message}"
        return Outcome("aborted", codes.PATH_TOLERANCE_VIOLATED, message, sentence)

    def _asked(self, point: int) -> Payload:
        """Returns position and orientation of a point; the orientation is None if any serves."""
        trajectory = self.trajectory
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

    def _target(self, point: int) -> Target:
        """Returns the target at a point of the trajectory."""
        trajectory, manipulator = self.trajectory, self._manipulator
        turns, fixed = float(trajectory.turns[point]), trajectory.fixed.get(point)
        return Target(
            trajectory.positions[point],
            float(trajectory.tolerances[point]),
            trajectory.rotations[point] if turns < np.inf else None,
            turns,
            None if fixed is None else format_configuration(manipulator, manipulator.configuration(fixed)),
        )


class JogReport:
    """The reports on a jog; it has no feedback.

    Args:
        name: id of the result.
        jogged: new state of each actuator, by index.
    """

    waypoint = target = present = None
    count = 1
    waypoints: Sequence[Payload] = ()

    def __init__(self, name: str, jogged: dict[int, int]) -> None:
        self.id, self._jogged = name, jogged

    def context(self, sent: float, proof: Proof | None) -> bytes:
        """Returns the context that comes back with the result."""
        return encode_context(Context(self.id, sent=sent, proof=proof, jogged=self._jogged))

    def begun(self, point: int) -> None:
        """Does nothing."""

    def settled(self, message: Settled, measured: Measured, deviation: float | None) -> Payload | None:
        """Returns no feedback."""
        return None

    def left_path(self, point: int, measured: Measured) -> Outcome | None:
        """Returns no outcome: a jog has no path."""
        return None


Report = GoalReport | JogReport


def outcome_of(manipulator: Manipulator, ended: Ended, measured: Measured, context: Context) -> Outcome:
    """Returns the outcome of a program as the executor ended it, judged by the measured states (A,)."""
    if ended.status != "done":
        return Outcome(ended.status, STATUS_CODES[ended.status], ended.message)
    if context.target is None:
        return jog_outcome(manipulator, measured, context)
    where = measured_pose(manipulator, measured, context.target)
    return last_waypoint_outcome(context.id, context.target, where)


def last_waypoint_outcome(goal: str, target: Target, where: Payload) -> Outcome:
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


def jog_outcome(manipulator: Manipulator, measured: Measured, context: Context) -> Outcome:
    """Returns whether the actuators of a jog are measured in their new states, as an outcome."""
    apart = [manipulator.actuators[k] for k, state in sorted(context.jogged.items()) if measured[k] != state]
    if not apart:
        return Outcome("succeeded", codes.SUCCESSFUL, "switched", "holding; the actuators were switched")
    message = f"not measured in the requested state: {', '.join(apart)}"
    return Outcome("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; {message}")


def collision_outcome(goal: str, words: str) -> Outcome:
    """Returns the outcome of a goal whose remaining stages would collide."""
    message = f"the planned motion would collide: {words}; the arm holds"
    sentence = f"holding; goal {goal} was aborted: the planned motion would collide: {words}"
    return Outcome("aborted", codes.PATH_TOLERANCE_VIOLATED, message, sentence)


def result_of(
    manipulator: Manipulator,
    ended: Ended,
    measured: Measured,
    context: Context,
    outcome: Outcome,
    target: Target | None,
) -> Payload:
    """Returns the payload of a result.

    The certificate is that of the plan from where the goal began. It stands there only if the arm did exactly the
    switches that it speaks of; otherwise `certificate` is "unknown".

    Args:
        manipulator: the whole arm.
        ended: the executor's message.
        measured: actuator states, shape (A,).
        context: of the program.
        outcome: of the goal.
        target: from which the errors are given; None: they are not given.
    """
    proof, bias = context.proof, {} if context.bias is None else {"bias": context.bias}
    shown: Payload = {}
    if context.jogged or not context.position:
        labels = manipulator.actuators
        travels = [
            {"actuator": labels[travel.actuator], "state": STATES[travel.state], "seconds": travel.seconds}
            for travel in ended.travels
        ]
        shown = {"travels": travels}
    elif proof is not None:
        as_planned = outcome.status == "succeeded" and proof.switches == ended.switches
        kind = proof.certificate if as_planned else "unknown"
        known = kind in ("optimal", "bound")
        shown = {
            "planned_switches": proof.switches,
            "optimal": kind == "optimal" if known else None,
            "lower_bound": proof.bound if known else None,
            "certificate": kind,
        }
    return {
        "id": context.id,
        "status": outcome.status,
        "code": outcome.code,
        "message": outcome.message,
        "switches": ended.switches,
        **measured_pose(manipulator, measured, target),
        **bias,
        **shown,
    }
