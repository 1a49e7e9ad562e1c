"""A goal or jog from its arrival to its result, and the program that carries it out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec
import numpy as np

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.motion.decoding.goal import GoalMessage, Jog
from hyperbit.controller.motion.stages.feed import Feed, PlannedPoint, Route
from hyperbit.controller.motion.stages.program import delay_of, in_groups
from hyperbit.controller.planning.core.arm import ArmState, States, packed
from hyperbit.controller.planning.core.events import done
from hyperbit.controller.planning.core.parts import Parts, Ticket
from hyperbit.controller.planning.core.reports import Context, GoalOutcome, GoalReport
from hyperbit.controller.planning.core.tasks import Basis, Planned
from hyperbit.controller.program import Ended, Program, Settled
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

MOST_CONTEXT = 8_192  # bytes, limit of the executor's contract


@dataclass(eq=False)
class Goal:
    """A goal or jog. It belongs to `Goals` until the executor has accepted it, then to `Programs`."""

    request: int
    ticket: Ticket
    wanted: GoalMessage | Jog
    id: str
    received: float  # time of arrival [UNIX s]
    begin_by: float  # time by which the executor must accept it [s]
    since: float  # when the present wait began [s]
    state: Literal["waiting", "offered", "running"] = "waiting"
    job: int | None = None  # number of the task that plans, checks or improves it

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
    answer: dict[str, Any] = field(init=False)  # sent when the ledger has the acceptance
    delay: float = 0.0  # the trajectory's t = 0 in the program's time [s]
    unchecked: bool = False  # it cannot be checked: the arm's position is unknown

    # --- from its acceptance on
    begin: float = 0.0  # the program's zero of time [s]
    stage_began: float = 0.0  # when its latest stage began [s]
    unrecorded: int | None = None  # entry of the acceptance that the ledger does not have yet
    outcome: GoalOutcome | None = None  # the planner's reason to end it; the executor's result follows
    deviates: bool = False  # whether the deviations of its points are still awaited
    held: deque[Settled | Ended] = field(default_factory=deque)  # reports that wait for the deviations, in order
    checking: int | None = None  # number of the task that checks its next stages
    switches: int = 0  # as last reported by the executor

    @property
    def end(self) -> float:
        """When its last stage is expected to end [s]; in the past if the arm is late or waits."""
        return self.begin + self.feed.end(self.stage_began - self.begin)

    def progress(self, wall: float) -> dict[str, Any]:
        """Returns how far it is; `wall`: UNIX time of the zero of the planner's clock [s]."""
        reached, waypoints = (0, 1) if self.report is None else (self.report.reached, self.report.count)
        begins, ends = (round(wall + moment, 1) for moment in (self.begin, self.end))
        return {"waypoints": waypoints, "reached": reached, "begins": begins, "ends": ends}


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
        words += f"{'switch' if switches == 1 else 'switches'} planned"
        goal.report = GoalReport(parts.view.manipulator, goal.id, trajectory)
        context = goal.report.context(moment.wall, proof)
    else:
        assert isinstance(goal.wanted, Jog)
        assert planned is not None
        name, wanted, stages = f"jog {goal.id}", goal.wanted.states, tuple(state.pack(planned))
        points, times, others = (PlannedPoint(0, stages, None, 0),), (pace.lead * len(stages),), (False,)
        switches = int(np.count_nonzero(state.commanded != planned[-1]))
        named = ", ".join(f"{labels[k]} {STATES[to]}" for k, to in wanted.items())
        words = f"accepted, {switches} {'switch' if switches == 1 else 'switches'}: {named}"
        goal.unchecked, homed = unsure is not None, packed(np.isin(np.arange(len(labels)), list(wanted)))
        strict = strict and not goal.unchecked
        context = Context(goal.id, sent=moment.wall, jogged=wanted)
    if unsure is not None and not scene.free:  # motions from an unknown position are not checked
        words += f"; collisions{' of the homing' if goal.report else ''} were not checked, because {unsure}"
    goal.answer = {**done(words if goal.report else words[:1_000]), "id": goal.id}
    route = Route(state.snapshot.outputs, points, times, others, pace.lead, goal.delay, most)
    number = parts.next_number()
    goal.feed = feed = Feed(parts.view.manipulator, number, route, strict, scene.generation, proof)
    if len(data := msgspec.msgpack.encode(context)) > MOST_CONTEXT:
        data = msgspec.msgpack.encode(msgspec.structs.replace(context, configuration=None, jogged={}))
    sent, epoch = (feed.first, feed.complete, strict, name, data, homed), goal.ticket.epoch or 0
    goal.program = Program(number, epoch, route.start, begin, *sent, goal.begin_by)
