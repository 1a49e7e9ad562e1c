"""Programs of planned goals and of jogs: stages, times, and the context of the result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.motion.stages.feed import Feed, PlannedPoint, PlanProof, Route
from hyperbit.controller.motion.stages.program import delay_of, in_groups
from hyperbit.controller.planning.core.arm import ArmState, States, packed
from hyperbit.controller.planning.core.events import done
from hyperbit.controller.planning.core.parts import Parts, Ticket
from hyperbit.controller.planning.core.programs import InFlight
from hyperbit.controller.planning.core.reports import GoalReport, JogReport, Report
from hyperbit.controller.planning.core.tasks import Basis, Planned
from hyperbit.controller.program import Program
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

if TYPE_CHECKING:
    from hyperbit.controller.motion.decoding.goal import GoalMessage, Jog
    from hyperbit.controller.motion.stages.pacing import Pace


@dataclass(eq=False)
class Motion:
    """A goal or jog that has not begun.

    Attributes:
        wanted: goal, or new states of single actuators by index.
        received: time of arrival [UNIX s].
        begin_by: time by which the executor must accept it [s].
        since: when the present wait began [s].
        job: number of the task that plans or checks it; None: no task.
        basis: what the plan holds for.
        planned: the plan of a goal, or the stages (k, A) of a jog; None: there is none for the present basis.
        program: number of its program, if that waits for the executor's answer.
        waits: the snapshot after which it is offered again; None: it does not wait for one.
        plan_by: end of its planning, by its own deadline [s]; None: planning has not begun, or has no deadline.
        why: why it was planned or offered again, and would be refused then; None: it was not.
    """

    request: int
    ticket: Ticket
    wanted: GoalMessage | Jog
    id: str
    received: float
    begin_by: float
    since: float
    job: int | None = None
    basis: Basis | None = None
    planned: Planned | States | None = None
    program: int | None = None
    waits: ArmState | None = None
    plan_by: float | None = None
    why: Refusal | None = None


class Draft(NamedTuple):
    """What a program is made from.

    Attributes:
        words: of the answer.
        strict: whether no stage may be skipped.
        begin: zero of time [s]; 0 means now.
        homed: packed mask of the actuators of unknown state that are homed; empty: all.
    """

    route: Route
    report: Report
    name: str
    words: str
    strict: bool
    begin: float = 0.0
    proof: PlanProof | None = None
    homed: bytes = b""


def goal_program(parts: Parts, motion: Motion, planned: Planned, state: ArmState, basis: Basis) -> InFlight:
    """Returns the program of a planned goal, given the present state and basis.

    Raises:
        Refusal: the trajectory has ended before it was planned.
    """
    trajectory, moment, strict = planned.trajectory, parts.moment, not basis.scene.free
    late = 0.0 if trajectory.stamp is None else moment.wall - trajectory.stamp - float(trajectory.times[-1])
    if late > 0:
        raise Refusal(Reason.PLANNED_TOO_LATE, late=f"{late:.3f}")
    first, begin, delay = planned.points[0].stages, 0.0, 0.0
    if trajectory.stamp is not None:
        begin = trajectory.stamp + moment.now - moment.wall
    else:
        waits = max(parts.view.rest.ready(state, first[0], strict) - moment.now, 0.0)
        delay = delay_of(trajectory, parts.pace.lead * len(first) + waits)
    between = np.ones(len(planned.points), np.bool_)
    between[trajectory.waypoints] = False
    times, most = trajectory.times.tolist(), parts.pace.inrush or len(parts.view.manipulator.actuators)
    route = Route(state.snapshot.outputs, planned.points, times, between.tolist(), parts.pace.lead, delay, most)
    report = GoalReport(parts.view.manipulator, motion.id, trajectory)
    waypoints, switches = len(trajectory.waypoints), planned.proof.switches
    points = f"{waypoints} {'waypoint' if waypoints == 1 else 'waypoints'}"
    words = f"accepted, {points}, {switches} {'switch' if switches == 1 else 'switches'} planned"
    words += _unchecked(state, basis, of=" of the homing")
    draft = Draft(route, report, f"goal {motion.id}", words, strict, begin, planned.proof)
    program = _in_flight(parts, motion, draft, basis)
    program.plan, program.tables, program.delay = planned.plan, basis.tables, delay
    return program


def jog_stages(state: ArmState, wanted: dict[int, int], pace: Pace) -> States:
    """Returns the stages (k, A) that switch single actuators, given by index, to new states.

    Raises:
        Refusal: an actuator is locked.
    """
    labels = state.manipulator.actuators
    for k in wanted:
        if state.locked[k]:
            raise Refusal(Reason.ACTUATOR_LOCKED, actuator=labels[k])
    target = state.commanded.copy()
    target[list(wanted)] = list(wanted.values())
    return in_groups(state.commanded, target, pace.inrush or len(labels))


def unsure_of(state: ArmState) -> str | None:
    """Returns why the stages of a jog from a state cannot be checked for collisions; None if they can."""
    if state.unknown_state is not None or state.configuration is None:
        return "the arm is in no configuration"
    if (unknown := np.flatnonzero(state.homing)).size:
        labels = ", ".join(state.manipulator.actuators[k] for k in unknown)
        return f"it is not known where {labels} {'is' if len(unknown) == 1 else 'are'}"
    return None


def jog_program(
    parts: Parts, motion: Motion, wanted: dict[int, int], stages: States, state: ArmState, basis: Basis
) -> InFlight:
    """Returns the program that switches single actuators in stages (k, A), given the present state and basis."""
    labels, lead = state.manipulator.actuators, parts.pace.lead
    point = PlannedPoint(0, tuple(state.pack(stages)), None, 0)
    times, most = (lead * len(point.stages),), parts.pace.inrush or len(labels)
    route = Route(state.snapshot.outputs, (point,), times, (False,), lead, 0.0, most)
    known = unsure_of(state) is None
    switches = np.count_nonzero(state.commanded != stages[-1])
    named = ", ".join(f"{labels[k]} {STATES[to]}" for k, to in wanted.items())
    words = f"accepted, {switches} {'switch' if switches == 1 else 'switches'}: {named}"
    words = f"{words}{_unchecked(state, basis)}"[:1_000]
    homed = packed(np.isin(np.arange(len(labels)), list(wanted)))
    report, strict = JogReport(motion.id, wanted), known and not basis.scene.free
    program = _in_flight(parts, motion, Draft(route, report, f"jog {motion.id}", words, strict, homed=homed), basis)
    program.unchecked = not known
    return program


def _unchecked(state: ArmState, basis: Basis, of: str = "") -> str:
    """Returns the end of an answer: among obstacles, motions from an unknown position are not checked."""
    unsure = unsure_of(state)
    return "" if unsure is None or basis.scene.free else f"; collisions{of} were not checked, because {unsure}"


def _in_flight(parts: Parts, motion: Motion, draft: Draft, basis: Basis) -> InFlight:
    """Returns the program, and what belongs to it while it is in flight."""
    number, manipulator = parts.next_number(), parts.view.manipulator
    route, report, name, words, strict, begin, proof, homed = draft
    feed = Feed(manipulator, number, route, strict, basis.scene.generation, proof)
    epoch, context = motion.ticket.epoch or 0, report.context(parts.moment.wall, proof)
    first = feed.first
    program = Program(
        number, epoch, route.start, begin, first, feed.complete, strict, name, context, homed, motion.begin_by
    )
    return InFlight(program, motion.request, report, feed, {**done(words), "id": motion.id})
