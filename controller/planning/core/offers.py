"""Programs of planned goals and of jogs: stages, times, and the context of the result."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from controller.manipulator.locked import STATES
from controller.motion.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP, Refusal
from controller.motion.feed import Feed, PlannedPoint, Proof, Route
from controller.motion.program import delay_of, in_groups, unpack_states
from controller.planning.core.arm import ArmState, States, packed
from controller.planning.core.events import done
from controller.planning.core.parts import Parts, Ticket
from controller.planning.core.programs import InFlight
from controller.planning.core.reports import GoalReport, JogReport, Report
from controller.planning.core.tasks import Planned, Scene
from controller.program import Program

if TYPE_CHECKING:
    from controller.motion.pacing import Pace

UNCHECKED = "; collisions were not checked, because the arm is in no configuration"


class Offer(NamedTuple):
    """A request that is planned and may be sent now."""

    request: int
    ticket: Ticket
    id: str
    state: ArmState
    scene: Scene


class Made(NamedTuple):
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
    proof: Proof | None = None
    homed: bytes = b""


def goal_program(parts: Parts, offer: Offer, planned: Planned) -> InFlight:
    """Returns the program of a planned goal.

    Raises:
        Refusal: the trajectory has ended before it was planned.
    """
    trajectory, moment, state = planned.trajectory, parts.moment, offer.state
    late = 0.0 if trajectory.stamp is None else moment.wall - trajectory.stamp - float(trajectory.times[-1])
    if late > 0:
        raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: the trajectory ended {late:.3f} s before it was planned")
    first, begin, delay = planned.points[0].stages, 0.0, 0.0
    if trajectory.stamp is not None:
        begin = trajectory.stamp + moment.now - moment.wall
    else:
        stage = unpack_states(state.real(first[0]), len(state.outputs))
        waits = max(parts.view.rest.ready(state, stage, not offer.scene.free) - moment.now, 0.0)
        delay = delay_of(trajectory, parts.pace.lead * len(first) + waits)
    between = np.ones(len(planned.points), np.bool_)
    between[trajectory.waypoints] = False
    times = trajectory.times.tolist()
    route = Route(state.snapshot.outputs, planned.points, times, between.tolist(), parts.pace.lead, delay)
    report = GoalReport(parts.view.manipulator, offer.id, trajectory)
    waypoints, switches = len(trajectory.waypoints), planned.proof.switches
    points = f"{waypoints} {'waypoint' if waypoints == 1 else 'waypoints'}"
    words = f"accepted, {points}, {switches} {'switch' if switches == 1 else 'switches'} planned"
    made = Made(route, report, f"goal {offer.id}", words, not offer.scene.free, begin, planned.proof)
    program = _in_flight(parts, offer, made)
    program.plan, program.delay = planned.plan, delay
    return program


def jog_stages(state: ArmState, wanted: dict[int, int], pace: Pace) -> States:
    """Returns the stages (k, A) that switch single actuators.

    Args:
        state: of the arm.
        wanted: new state of each actuator, by index.
        pace: of the arm's transitions.

    Raises:
        Refusal: an actuator is locked.
    """
    labels = state.manipulator.actuators
    for k in wanted:
        if state.locked[k]:
            raise Refusal(INVALID_GOAL, f"actuators: {labels[k]} is locked: unlock it with `degrade` first")
    target = state.commanded.copy()
    target[list(wanted)] = list(wanted.values())
    return in_groups(state.commanded, target, pace.inrush or len(labels))


def jog_program(parts: Parts, offer: Offer, wanted: dict[int, int], stages: States) -> InFlight:
    """Returns the program that switches single actuators in stages (k, A)."""
    state, labels, lead = offer.state, offer.state.manipulator.actuators, parts.pace.lead
    point = PlannedPoint(0, tuple(state.pack(stages)), None, 0)
    route = Route(state.snapshot.outputs, (point,), (lead * len(point.stages),), (False,), lead, 0.0)
    known = state.unknown_state is None and state.configuration is not None
    unchecked = UNCHECKED if not known and not offer.scene.free else ""
    switches = np.count_nonzero(state.commanded != stages[-1])
    named = ", ".join(f"{labels[k]} {STATES[to]}" for k, to in wanted.items())
    words = f"accepted, {switches} switches: {named}{unchecked}"[:1_000]
    homed = packed(np.isin(np.arange(len(labels)), list(wanted)))
    strict, name = known and not offer.scene.free, f"jog {offer.id}"
    program = _in_flight(parts, offer, Made(route, JogReport(offer.id, wanted), name, words, strict, homed=homed))
    program.unchecked = not known
    return program


def _in_flight(parts: Parts, offer: Offer, made: Made) -> InFlight:
    """Returns the program, and what belongs to it while it is in flight."""
    number, manipulator, route = parts.numbers.next(), parts.view.manipulator, made.route
    most = parts.pace.inrush or len(manipulator.actuators)
    feed = Feed(manipulator, number, route, made.strict, offer.scene.generation, made.proof, most)
    program = Program(
        number,
        offer.ticket.epoch or 0,
        route.start,
        made.begin,
        feed.first,
        feed.complete,
        made.strict,
        made.name,
        made.report.context(parts.moment.wall, made.proof),
        made.homed,
    )
    answer = {**done(made.words), "id": offer.id}
    return InFlight(program, offer.request, offer.ticket, made.report, feed, answer)
