"""Reports on one goal: the context of its result, feedback at its marks, and the present waypoint."""

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

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator


class Context(msgspec.Struct, frozen=True, omit_defaults=True):
    """Data for the result of a goal or jog; the executor returns it with the result."""

    id: str
    waypoints: int = 1  # their number
    last_mark: int = 0  # mark of the last waypoint; the next five fields describe it, as in `GoalTarget`
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
        if not self.position:
            return None
        rotation = np.array(self.rotation).reshape(3, 3) if self.rotation else None
        angle = self.angle_tolerance if self.rotation else np.inf
        return GoalTarget(np.array(self.position), self.tolerance, rotation, angle, self.configuration)


class GoalOutcome(NamedTuple):  # the end of a goal for its result
    status: str
    code: int
    message: str
    sentence: str = ""  # on what the arm does then


class GoalReport:
    def __init__(self, manipulator: Manipulator, goal: str, trajectory: Trajectory) -> None:
        self.count, self.reached = len(trajectory.waypoints), 0  # waypoints, and those of them that have settled
        self._manipulator, self._goal, self._trajectory = manipulator, goal, trajectory
        self._point = -1
        self._stages = 0  # since the waypoint before
        self._deviation: float | None = 0.0  # greatest one since the waypoint before; None: not known

    def context(self, sent: float, proof: PlanProof) -> Context:
        last, bias = len(self._trajectory.times) - 1, self._trajectory.bias
        target = self._target(last)
        rotation = [] if target.rotation is None else target.rotation.ravel().tolist()
        angle, numbers = target.angle_tolerance if rotation else 0.0, None if bias is None else bias.tolist()
        where = target.position.tolist(), target.tolerance, rotation, angle, target.configuration
        return Context(self._goal, self.count, last, *where, numbers, sent, proof)

    @property
    def waypoint(self) -> int | None:
        """The waypoint that the arm moves to or is at; None before the first."""
        last = self._trajectory.last(self._point)
        return last if last >= 0 else None

    @property
    def target(self) -> Payload:
        """Position and orientation of the present point; before its start those of the first point."""
        return self._asked(max(self._point, 0))

    @property
    def waypoints(self) -> Sequence[Payload]:
        """All waypoints: time, position and orientation as the goal gave them, not corrected by the tip bias."""
        return [{"t": self._trajectory.times[k], **self._asked(k)} for k in self._trajectory.waypoints.tolist()]

    @property
    def present(self) -> GoalTarget:
        return self._target(max(self._point, 0))

    def begun(self, point: int) -> None:
        self._point = max(point, self._point)

    def settled(self, message: Settled, measured: Measured, deviation: float | None) -> Payload | None:
        """Returns the feedback of a settled waypoint, None for other points; `deviation` is of its transition."""
        point, trajectory = message.mark, self._trajectory
        self._stages += message.stages
        so_far = self._deviation
        self._deviation = None if so_far is None or deviation is None else max(so_far, deviation)
        if trajectory.between(point):
            return None
        self.reached = trajectory.last(point) + 1
        feedback = {
            "id": self._goal,
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

    def left_path(self, point: int, measured: Measured) -> str | None:
        """Returns how far the measured tip has left its path at a settled point, in words; otherwise None."""
        trajectory = self._trajectory
        if trajectory.path_tolerance is None or point == len(trajectory.times) - 1:
            return None
        error = measured_pose(self._manipulator, measured, self._target(point))["error"]
        tolerance = trajectory.tolerances[point] if trajectory.between(point) else trajectory.path_tolerance
        if error is not None and error <= tolerance:
            return None
        away = "unknown" if error is None else f"{error:.4f} from the moving target"
        at = f"after waypoints[{trajectory.last(point)}] the measured tip is {away}"
        return f"{at}, path_tolerance {trajectory.path_tolerance:g}"

    def _asked(self, point: int) -> Payload:
        """Returns position and orientation of a point; the orientation is None if any is accepted."""
        trajectory = self._trajectory
        position = trajectory.positions[point]
        if trajectory.bias is not None and point not in trajectory.fixed:
            position = position + trajectory.bias
        frame = np.eye(4)
        frame[:3, :3] = trajectory.rotations[point]
        orientation = pose(self._manipulator, frame)["orientation"] if trajectory.turns[point] < np.inf else None
        return {"position": position.tolist(), "orientation": orientation}

    def _target(self, point: int) -> GoalTarget:
        trajectory, manipulator = self._trajectory, self._manipulator
        turns, fixed = float(trajectory.turns[point]), trajectory.fixed.get(point)
        return GoalTarget(
            trajectory.positions[point],
            float(trajectory.tolerances[point]),
            trajectory.rotations[point] if turns < np.inf else None,
            turns,
            None if fixed is None else format_configuration(manipulator, manipulator.configuration(fixed)),
        )
