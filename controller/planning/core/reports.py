"""The reports on one program: its context, feedback at its marks, and its one result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from hyperbit.controller.manipulator.notation import format_configuration, pose
from hyperbit.controller.motion.stages.feed import PlanProof
from hyperbit.controller.motion.targets import GoalTarget, measured_pose
from hyperbit.controller.motion.trajectory import Trajectory
from hyperbit.controller.planning.core.arm import Measured
from hyperbit.controller.planning.core.events import Payload
from hyperbit.controller.program import Settled
from hyperbit.controller.refusals import codes

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator

MOST_BYTES = 8_192  # limit of the executor's contract


class Context(msgspec.Struct, frozen=True, omit_defaults=True):
    """What the result of a goal or jog needs; it comes back with the result."""

    id: str
    waypoints: int = 1  # their number
    last_mark: int = 0  # mark of the last waypoint, which the next five attributes describe as in `GoalTarget`
    position: list[float] = []  # empty for a jog, which has no target
    tolerance: float = 0.0
    rotation: list[float] = []  # nine numbers, row by row; empty: any orientation serves
    angle_tolerance: float = 0.0
    configuration: str | None = None
    bias: list[float] | None = None  # tip bias by which the goal was corrected; None: no tracker
    sent: float = 0.0  # time at which the program was made [UNIX s]
    proof: PlanProof | None = None  # of the plan; None for a jog
    jogged: dict[int, int] = {}  # new state of each actuator of a jog, by index

    @property
    def target(self) -> GoalTarget | None:
        """The last waypoint; None for a jog."""
        if not self.position:
            return None
        turned = bool(self.rotation)
        return GoalTarget(
            np.array(self.position),
            self.tolerance,
            np.array(self.rotation).reshape(3, 3) if turned else None,
            self.angle_tolerance if turned else np.inf,
            self.configuration,
        )


def encode_context(context: Context) -> bytes:
    """Returns a context as bytes; omits the configuration and the jogged actuators if it would be too long."""
    data = msgspec.msgpack.encode(context)
    if len(data) > MOST_BYTES:
        data = msgspec.msgpack.encode(msgspec.structs.replace(context, configuration=None, jogged={}))
    return data


def decode_context(data: bytes) -> Context | None:
    """Returns the context in a result; None if it cannot be decoded, as from another version of the planner."""
    try:
        return msgspec.msgpack.decode(data, type=Context)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):
        return None


class GoalOutcome(NamedTuple):
    """The end of a goal: status, code and message of its result."""

    status: str
    code: int
    message: str
    sentence: str = ""  # on what the arm does then


class GoalReport:
    def __init__(self, manipulator: Manipulator, goal: str, trajectory: Trajectory) -> None:
        self.id, self.trajectory, self.count = goal, trajectory, len(trajectory.waypoints)  # count: of waypoints
        self._manipulator = manipulator
        self._point = -1
        self._stages = 0  # since the waypoint before
        self._deviation: float | None = 0.0  # greatest one since the waypoint before; None: not known

    def context(self, sent: float, proof: PlanProof | None) -> bytes:
        last, bias = len(self.trajectory.times) - 1, self.trajectory.bias
        target = self._target(last)
        rotation = [] if target.rotation is None else target.rotation.ravel().tolist()
        angle, numbers = target.angle_tolerance if rotation else 0.0, None if bias is None else bias.tolist()
        where = target.position.tolist(), target.tolerance, rotation, angle, target.configuration
        return encode_context(Context(self.id, self.count, last, *where, numbers, sent, proof))

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
    def present(self) -> GoalTarget:
        return self._target(max(self._point, 0))

    def begun(self, point: int) -> None:
        """Notes that the stages to a point have begun."""
        self._point = max(point, self._point)

    def settled(self, message: Settled, measured: Measured, deviation: float | None) -> Payload | None:
        """Returns the feedback of a settled point, None if it is no waypoint; `deviation` is of its transition."""
        point, trajectory = message.mark, self.trajectory
        self._stages += message.stages
        so_far = self._deviation
        self._deviation = None if so_far is None or deviation is None else max(so_far, deviation)
        if trajectory.between(point):
            return None
        feedback = {
            "id": self.id,
            "waypoint": trajectory.last(point),
            "waypoints": self.count,
            "switches": message.switches,
            "stages": self._stages,
            "excursion": self._deviation,
            **measured_pose(self._manipulator, measured, self._target(point)),
            **({} if trajectory.bias is None else {"bias": trajectory.bias}),
        }
        self._stages, self._deviation = 0, 0.0
        return feedback

    def left_path(self, point: int, measured: Measured) -> GoalOutcome | None:
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
        return GoalOutcome("aborted", codes.PATH_TOLERANCE_VIOLATED, message, sentence)

    def _asked(self, point: int) -> Payload:
        """Returns position and orientation of a point; the orientation is None if any serves."""
        trajectory = self.trajectory
        position = trajectory.positions[point]
        if trajectory.bias is not None and point not in trajectory.fixed:
            position = position + trajectory.bias
        frame = np.eye(4)
        frame[:3, :3] = trajectory.rotations[point]
        orientation = pose(self._manipulator, frame)["orientation"] if trajectory.turns[point] < np.inf else None
        return {"position": position.tolist(), "orientation": orientation}

    def _target(self, point: int) -> GoalTarget:
        trajectory, manipulator = self.trajectory, self._manipulator
        turns, fixed = float(trajectory.turns[point]), trajectory.fixed.get(point)
        return GoalTarget(
            trajectory.positions[point],
            float(trajectory.tolerances[point]),
            trajectory.rotations[point] if turns < np.inf else None,
            turns,
            None if fixed is None else format_configuration(manipulator, manipulator.configuration(fixed)),
        )


class JogReport:
    """The report on a jog, which has new states of actuators, by index, no path and no feedback."""

    waypoint = target = present = None
    count = 1
    waypoints: Sequence[Payload] = ()

    def __init__(self, name: str, jogged: dict[int, int]) -> None:
        self.id, self._jogged = name, jogged

    def context(self, sent: float, proof: PlanProof | None) -> bytes:
        return encode_context(Context(self.id, sent=sent, proof=proof, jogged=self._jogged))

    def begun(self, point: int) -> None:
        pass

    def settled(self, message: Settled, measured: Measured, deviation: float | None) -> None:
        pass

    def left_path(self, point: int, measured: Measured) -> None:
        pass


Report = GoalReport | JogReport


def collision_outcome(goal: str, words: str) -> GoalOutcome:
    """Returns the outcome of a goal whose remaining stages would collide."""
    message = f"the planned motion would collide: {words}; the arm holds"
    sentence = f"holding; goal {goal} was aborted: the planned motion would collide: {words}"
    return GoalOutcome("aborted", codes.PATH_TOLERANCE_VIOLATED, message, sentence)
