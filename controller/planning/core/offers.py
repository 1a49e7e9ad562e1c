"""Programs of planned goals and of jogs: stages, times, and the context of the result."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.motion.stages.feed import Feed, PlannedPoint, PlanProof, Route
from hyperbit.controller.motion.stages.program import delay_of, in_groups
from hyperbit.controller.planning.core.arm import ArmState, States, packed
from hyperbit.controller.planning.core.events import done
from hyperbit.controller.planning.core.goal import Goal
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.reports import GoalReport, JogReport, Report
from hyperbit.controller.planning.core.tasks import Basis, Planned
from hyperbit.controller.program import Program
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

if TYPE_CHECKING:
    from hyperbit.controller.motion.stages.pacing import Pace


def make_goal_program(parts: Parts, goal: Goal, planned: Planned, state: ArmState, basis: Basis) -> None:
    """Makes the program of a planned goal; raises Refusal if the trajectory has ended before it was planned."""
    trajectory, moment, strict = planned.trajectory, parts.moment, not basis.scene.free
    late = 0.0 if trajectory.stamp is None else moment.wall - trajectory.stamp - float(trajectory.times[-1])
    if late > 0:
        raise Refusal(Reason.PLANNED_TOO_LATE, late=f"{late:.3f}")
    first, begin, delay = planned.points[0].stages, 0.0, 0.0
    if trajectory.stamp is not None:
        begin = trajectory.stamp + moment.now - moment.wall
    else:
        waits = max(parts.view.ready_at(state, first[0], strict) - moment.now, 0.0)
        delay = delay_of(trajectory, parts.pace.lead * len(first) + waits)
    between = np.ones(len(planned.points), np.bool_)
    between[trajectory.waypoints] = False
    times, most = trajectory.times.tolist(), parts.pace.inrush or len(parts.view.manipulator.actuators)
    route = Route(state.snapshot.outputs, planned.points, times, between.tolist(), parts.pace.lead, delay, most)
    waypoints, switches = len(trajectory.waypoints), planned.proof.switches
    points = f"{waypoints} {'waypoint' if waypoints == 1 else 'waypoints'}"
    words = f"accepted, {points}, {switches} {'switch' if switches == 1 else 'switches'} planned"
    words += _not_checked(state, basis, of=" of the homing")
    report = GoalReport(parts.view.manipulator, goal.id, trajectory)
    goal.delay = delay
    _make_program(parts, goal, basis, route, report, f"goal {goal.id}", words, strict, begin, planned.proof)


def jog_stages(state: ArmState, wanted: dict[int, int], pace: Pace) -> States:
    """Returns the stages (k, A) that switch actuators to new states; raises Refusal if one is locked."""
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


def make_jog_program(
    parts: Parts, goal: Goal, wanted: dict[int, int], stages: States, state: ArmState, basis: Basis
) -> None:
    """Makes the program that switches single actuators in stages (k, A), given the present state and basis."""
    labels, lead = state.manipulator.actuators, parts.pace.lead
    point = PlannedPoint(0, tuple(state.pack(stages)), None, 0)
    times, most = (lead * len(point.stages),), parts.pace.inrush or len(labels)
    route = Route(state.snapshot.outputs, (point,), times, (False,), lead, 0.0, most)
    switches = np.count_nonzero(state.commanded != stages[-1])
    named = ", ".join(f"{labels[k]} {STATES[to]}" for k, to in wanted.items())
    words = f"accepted, {switches} {'switch' if switches == 1 else 'switches'}: {named}"
    words = f"{words}{_not_checked(state, basis)}"[:1_000]
    homed = packed(np.isin(np.arange(len(labels)), list(wanted)))
    goal.unchecked = unsure_of(state) is not None
    report, strict = JogReport(goal.id, wanted), not goal.unchecked and not basis.scene.free
    _make_program(parts, goal, basis, route, report, f"jog {goal.id}", words, strict, homed=homed)


def _not_checked(state: ArmState, basis: Basis, of: str = "") -> str:
    """Returns the end of an answer: among obstacles, motions from an unknown position are not checked."""
    unsure = unsure_of(state)
    return "" if unsure is None or basis.scene.free else f"; collisions{of} were not checked, because {unsure}"


def _make_program(
    parts: Parts,
    goal: Goal,
    basis: Basis,
    route: Route,
    report: Report,
    name: str,
    words: str,
    strict: bool,
    begin: float = 0.0,
    proof: PlanProof | None = None,
    homed: bytes = b"",
) -> None:
    """Sets the program of a goal, and what belongs to it while it is in flight.

    `words` are of the answer. If `strict`, no stage may be skipped. `begin` is the zero of time [s]; 0 means now.
    `homed` is the packed mask of the actuators of unknown state that are homed; empty: all.
    """
    number, epoch, context = parts.next_number(), goal.ticket.epoch or 0, report.context(parts.moment.wall, proof)
    goal.report, goal.answer = report, {**done(words), "id": goal.id}
    goal.feed = feed = Feed(parts.view.manipulator, number, route, strict, basis.scene.generation, proof)
    goal.program = Program(
        number, epoch, route.start, begin, feed.first, feed.complete, strict, name, context, homed, goal.begin_by
    )
