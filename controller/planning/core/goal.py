"""A goal or jog from its arrival to its result: its record, its program, and what is told about it on the way."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.names import shortened
from hyperbit.controller.manipulator.notation import format_configuration, pose
from hyperbit.controller.messages.arm import RunningWaypoint
from hyperbit.controller.messages.goals import Answer, Feedback
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.messages.state import Progress
from hyperbit.controller.motion.decoding.goal import GoalMessage, Jog
from hyperbit.controller.motion.stages.feed import Feed, PlannedPoint, PlanProof, Route
from hyperbit.controller.motion.stages.program import States, delay_of, in_groups, packed
from hyperbit.controller.motion.targets import GoalTarget, measured_pose
from hyperbit.controller.motion.trajectory import Trajectory
from hyperbit.controller.planning.core.arm import ArmState, Measured
from hyperbit.controller.planning.core.events import PublishResult
from hyperbit.controller.planning.core.parts import Parts, Pending, Ticket
from hyperbit.controller.planning.core.tasks import Basis, Planned
from hyperbit.controller.program import Ended, Program, Settled
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, nth_waypoint

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator

MOST_CONTEXT = 8_192  # bytes, limit of the executor's contract


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
    homed: int = 0  # actuators of unknown position that are homed first, each with one switch

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
        self.point = -1  # that the arm moves to or is at; -1 before the first
        self._manipulator, self._goal, self._trajectory = manipulator, goal, trajectory
        self._stages = 0  # since the waypoint before
        self._deviation: float | None = 0.0  # greatest one since the waypoint before; None: not known

    def context(self, sent: float, proof: PlanProof, homed: int) -> Context:
        last, bias = len(self._trajectory.times) - 1, self._trajectory.bias
        target = self.target(last)
        rotation = [] if target.rotation is None else target.rotation.ravel().tolist()
        angle, numbers = target.angle_tolerance if rotation else 0.0, None if bias is None else bias.tolist()
        where = target.position.tolist(), target.tolerance, rotation, angle, target.configuration
        return Context(self._goal, self.count, last, *where, numbers, sent, proof, homed=homed)

    def present(self) -> tuple[int | None, Pose]:
        """Returns the waypoint, None before the first, and the target; before the start that of the first point."""
        waypoint = self._trajectory.last(self.point)
        return waypoint if waypoint >= 0 else None, self._asked(max(self.point, 0))

    def waypoints(self) -> list[RunningWaypoint]:
        """Returns all waypoints as the goal gave them, not corrected by the tip bias."""
        times = self._trajectory.times.tolist()
        every = ((times[k], self._asked(k)) for k in self._trajectory.waypoints.tolist())
        return [RunningWaypoint(t, pose.position, pose.orientation) for t, pose in every]

    def settled(
        self, message: Settled, measured: Measured, deviation: float | None, remaining: float
    ) -> Feedback | None:
        point, trajectory = message.mark, self._trajectory
        self._stages += message.stages
        so_far = self._deviation
        self._deviation = None if so_far is None or deviation is None else max(so_far, deviation)
        if trajectory.between(point):
            return None
        self.reached = trajectory.last(point) + 1
        feedback = Feedback(
            id=self._goal,
            waypoint=trajectory.last(point),
            waypoints=self.count,
            switches=message.switches,
            stages=self._stages,
            excursion=self._deviation,
            **measured_pose(self._manipulator, measured, self.target(point)),
            bias=UNSET if trajectory.bias is None else trajectory.bias.tolist(),
            remaining=remaining,
        )
        self._stages, self._deviation = 0, 0.0
        return feedback

    def left_path(self, point: int, measured: Measured) -> str | None:
        """Returns how far the measured tip has left its path at a settled point, in words; otherwise None."""
        trajectory = self._trajectory
        if trajectory.path_tolerance is None or point == len(trajectory.times) - 1:
            return None
        error = measured_pose(self._manipulator, measured, self.target(point))["error"]
        tolerance = trajectory.tolerances[point] if trajectory.between(point) else trajectory.path_tolerance
        if error is not None and error <= tolerance:
            return None
        away = "unknown" if error is None else f"{error:.4f} from the moving target"
        at = f"after {nth_waypoint(trajectory.last(point))} the measured tip is {away}"
        return f"{at}, path_tolerance {trajectory.path_tolerance:g}"

    def _asked(self, point: int) -> Pose:
        """Returns position and orientation of a point; the orientation is None if any is accepted."""
        trajectory = self._trajectory
        position = trajectory.positions[point]
        if trajectory.bias is not None and point not in trajectory.fixed:
            position = position + trajectory.bias
        frame = np.eye(4)
        frame[:3, :3] = trajectory.rotations[point]
        orientation = pose(self._manipulator, frame)["orientation"] if trajectory.turns[point] < np.inf else None
        return Pose(position.tolist(), orientation)

    def target(self, point: int) -> GoalTarget:
        trajectory, manipulator = self._trajectory, self._manipulator
        turns, fixed = float(trajectory.turns[point]), trajectory.fixed.get(point)
        return GoalTarget(
            trajectory.positions[point],
            float(trajectory.tolerances[point]),
            trajectory.rotations[point] if turns < np.inf else None,
            turns,
            None if fixed is None else format_configuration(manipulator, manipulator.configuration(fixed)),
        )


@dataclass(eq=False)
class Goal(Pending):
    """A goal or jog.

    `Goals` advances it until the executor accepts it, `Programs` from its offer to its end. It is over when it has a
    result and the ledger has its acceptance.
    """

    ticket: Ticket
    wanted: GoalMessage | Jog
    id: str
    received: float  # time of arrival [UNIX s]
    begin_by: float  # time by which the executor must accept it [s]
    state: Literal["waiting", "offered", "running", "ended"] = "waiting"

    # --- while it waits
    basis: Basis | None = None  # premises of the plan
    planned: Planned | States | None = None  # plan, or stages (k, A) of a jog; None: none for the present basis
    waits: ArmState | None = None  # it is offered again after a newer snapshot; None: it does not wait
    plan_by: float | None = None  # end of its planning by its own deadline [s]; None: it has not begun, or has none
    why: Refusal | None = None  # reason for the last repetition; becomes the refusal if time runs out

    # --- from its offer on, see `make_program`
    program: Program = field(init=False)  # as it was sent
    report: GoalReport | None = None  # None: a jog has no path and no feedback
    feed: Feed = field(init=False)
    answer: Answer = field(init=False)  # sent when the ledger has the acceptance
    delay: float = 0.0  # the trajectory's t = 0 in the program's time [s]
    unchecked: bool = False  # it cannot be checked: the arm's position is unknown

    # --- from its acceptance on
    begin: float = 0.0  # the program's zero of time [s]
    stage_began: float = 0.0  # when its latest stage began [s]
    unrecorded: int | None = None  # entry of the acceptance that the ledger does not have yet
    publication: PublishResult | None = None  # of its result, which waits until the ledger has the acceptance
    outcome: GoalOutcome | None = None  # the planner's reason to end it; the executor's result follows
    deviates: bool = False  # whether the deviations of its points are still awaited
    held: deque[Settled | Ended] = field(default_factory=deque)  # reports that wait for the deviations, in order
    checking: int | None = None  # number of the task that checks its next stages; `job` improves its plan
    switches: int = 0  # as last reported by the executor

    @property
    def end(self) -> float:
        """When its last stage is expected to end [s]; in the past if the arm is late or waits."""
        return self.begin + self.feed.end(self.stage_began - self.begin)

    def progress(self, wall: float) -> Progress:
        """Returns its progress; `wall`: UNIX time of the zero of the planner's clock [s]."""
        reached, waypoints = (0, 1) if self.report is None else (self.report.reached, self.report.count)
        return Progress(waypoints, reached, ends=round(wall + self.end, 1), begins=round(wall + self.begin, 1))


def jog_stages(parts: Parts, state: ArmState, wanted: dict[int, int]) -> States:
    """Returns the stages (k, A) that switch actuators to new states. Raises Refusal if one is locked."""
    labels = state.manipulator.actuators
    for k in wanted:
        if state.locked[k]:
            raise Refusal(Reason.ACTUATOR_LOCKED, actuator=labels[k])
    target = state.commanded.copy()
    target[list(wanted)] = list(wanted.values())
    return in_groups(state.commanded, target, parts.pace.inrush or len(labels))


def unsure_of(state: ArmState) -> str | None:
    """Returns why a jog's stages from a state cannot be checked for collisions; None if they can."""
    if state.unknown_state is not None or state.configuration is None:
        return "the arm is in no configuration"
    if (unknown := np.flatnonzero(state.homing)).size:
        labels = ", ".join(state.manipulator.actuators[k] for k in unknown)
        return f"it is not known where {labels} {'is' if len(unknown) == 1 else 'are'}"
    return None


def homing_words(state: ArmState) -> str:
    """Returns what a goal homes before its planned switches, to complete a sentence; "" if nothing."""
    if not (labels := state.homed_first):
        return ""
    count = f"{len(labels)} {'switch homes' if len(labels) == 1 else 'switches home'}"
    return f"; before them {count} actuators of unknown position: {shortened(labels)}"


def make_program(parts: Parts, goal: Goal, state: ArmState) -> None:
    """Sets the program of a planned goal or jog, and the fields that are used in flight.

    Raises Refusal if the trajectory has ended before it was planned.
    """
    planned, moment, pace, labels = goal.planned, parts.moment, parts.pace, state.manipulator.actuators
    assert goal.basis is not None
    scene, unsure, most = goal.basis.scene, unsure_of(state), pace.inrush or len(labels)
    strict = not scene.free  # whether no stage may be skipped
    begin, homed, proof = 0.0, b"", None  # the zero of time [s], 0: now; actuators of unknown state to home, b"": all
    if isinstance(planned, Planned):
        name, trajectory, proof = f"goal {goal.id}", planned.trajectory, planned.proof
        late = 0.0 if trajectory.stamp is None else moment.wall - trajectory.stamp - float(trajectory.times[-1])
        if late > 0:
            raise Refusal(Reason.PLANNED_TOO_LATE, late=f"{late:.3f}")
        first, goal.delay = planned.points[0].stages, 0.0
        if trajectory.stamp is not None:
            begin = trajectory.stamp + moment.now - moment.wall
        else:
            waits = max(parts.view.ready_at(state, first[0], strict) - moment.now, 0.0)
            goal.delay = delay_of(trajectory, pace.lead * len(first) + waits)
        between = np.ones(len(planned.points), np.bool_)
        between[trajectory.waypoints] = False
        points, times, others = planned.points, tuple(trajectory.times.tolist()), tuple(between.tolist())
        waypoints, switches = len(trajectory.waypoints), proof.switches
        words = f"accepted, {waypoints} {'waypoint' if waypoints == 1 else 'waypoints'}, {switches} "
        words += f"{'switch' if switches == 1 else 'switches'} planned{homing_words(state)}"
        goal.report = GoalReport(parts.view.manipulator, goal.id, trajectory)
        context = goal.report.context(moment.wall, proof, len(state.homed_first))
    else:
        assert isinstance(goal.wanted, Jog)
        assert planned is not None
        name, wanted, stages = f"jog {goal.id}", goal.wanted.states, tuple(state.start.sent(planned))
        points, times, others = (PlannedPoint(0, stages, None, 0),), (pace.lead * len(stages),), (False,)
        switches = int(np.count_nonzero(state.commanded != planned[-1]))
        named = ", ".join(f"{labels[k]} {STATES[to]}" for k, to in wanted.items())
        words = f"accepted, {switches} {'switch' if switches == 1 else 'switches'}: {named}"
        goal.unchecked, homed = unsure is not None, packed(np.isin(np.arange(len(labels)), list(wanted)))
        strict = strict and not goal.unchecked
        context = Context(goal.id, sent=moment.wall, jogged=wanted)
    if unsure is not None and not scene.free:  # motions from an unknown position are not checked
        words += f"; collisions{' of the homing' if goal.report else ''} were not checked, because {unsure}"
    told, homing = words if goal.report else words[:1_000], state.homed_first if goal.report else UNSET
    goal.answer = Answer(accepted=True, id=goal.id, message=told, homing=homing)
    route = Route(state.snapshot.outputs, points, times, others, pace.lead, goal.delay, most)
    number = parts.next_number()
    goal.feed = feed = Feed(parts.view.manipulator, number, route, strict, scene.generation, proof)
    if len(data := msgspec.msgpack.encode(context)) > MOST_CONTEXT:
        data = msgspec.msgpack.encode(msgspec.structs.replace(context, configuration=None, jogged={}))
    sent, epoch = (feed.first, feed.complete, strict, name, data, homed), goal.ticket.epoch or 0
    goal.program = Program(number, epoch, route.start, begin, *sent, goal.begin_by)
