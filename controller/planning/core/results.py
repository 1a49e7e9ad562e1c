"""Results: each is made, published, recorded and acknowledged, in this order, also one of an earlier process."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import msgspec
from msgspec import UNSET

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.decoding.decoding import Unreadable, decode_packed
from hyperbit.controller.host.journal import fields_of_result
from hyperbit.controller.host.process import Log
from hyperbit.controller.messages.goals import Result, Travel
from hyperbit.controller.motion.stages.feed import PlanProof
from hyperbit.controller.motion.targets import GoalTarget, measured_pose
from hyperbit.controller.planning.core import events
from hyperbit.controller.planning.core.arm import Measured
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, ResultEntry, ToExecutor
from hyperbit.controller.planning.core.goal import Context, Goal, GoalOutcome
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.program import Acknowledge, Ended
from hyperbit.controller.refusals import codes

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator

LOST = "the executor ended before it told how this goal ended; where the arm is now, `state` says"
SENT_AGAIN_WITHIN = 5.0  # [s] after its greeting; by then the executor has sent its stored results


@dataclass(eq=False)
class Untold:
    identity: Identity
    number: int | None  # of the result at the executor, for the acknowledgement; None: unknown to the executor
    accepted: AcceptanceEntry  # in case the ledger lacks it
    result: Result


class Owed(NamedTuple):
    """A goal that an earlier planner process accepted."""

    accepted: AcceptanceEntry
    published: ResultEntry | None  # its result, if that process published one; clients may have missed it


class Results:
    """The owner of results that are not yet acknowledged.

    A result is published once. When the executor sends it again, it is only recorded and acknowledged. If the ledger
    lacks a result that an earlier planner process published, the result may not have left that process. It is published
    again, with the field `repeated`. `owed` are goals whose results the ledger lacks.
    """

    def __init__(
        self, parts: Parts, published: Mapping[Identity, ResultEntry], owed: Mapping[Identity, AcceptanceEntry]
    ) -> None:
        self._view, self._moment, self._act = parts.view, parts.moment, parts.act
        self._owed = {identity: Owed(entry, published.get(identity)) for identity, entry in owed.items()}
        self._told = published.keys() - owed.keys()
        self._met_at = math.inf  # when the present executor was met [s]
        self._last = 0  # number of a publication or of an entry of the ledger
        self._on_way: dict[int, Untold] = {}  # by number of its publication, then of its entry

    @property
    def idle(self) -> bool:
        return not self._on_way

    def next_entry(self) -> int:
        self._last += 1
        return self._last

    def waive(self, identity: Identity) -> None:
        self._told.add(identity)

    def check(self) -> None:
        """Asserts that each result is on its way once; see `Core.check`."""
        on_way = [untold.identity for untold in self._on_way.values()]
        assert len(on_way) == len(set(on_way)), f"a result is on its way twice: {on_way}"
        assert self._told.issuperset(on_way), "a result on its way does not count as told"
        assert self._told.isdisjoint(self._owed), "a result that was told is still owed"

    # --- made

    def ended(self, message: Ended, goal: Goal | None) -> None:
        """Takes the executor's result of a program; `goal` is None for a program of an earlier planner process."""
        context, view = decode_context(message.context), self._view
        identity = Identity(view.instance or 0, message.program)
        for untold in self._on_way.values():
            if untold.identity == identity:  # on its way; the executor waits for its acknowledgement
                untold.number = message.result
                return
        if context is None:
            text = f"the result of program {message.program} has no context that this planner can decode: "
            self._act(Log(logging.WARNING, text + message.message))
            self._act(ToExecutor(Acknowledge(message.result)))
            return
        target = context.target if message.mark == context.last_mark else None
        outcome, planned, measured = self._told_outcome(identity), context.proof, view.measured_in(message)
        if goal is not None:
            context = msgspec.structs.replace(context, proof=goal.feed.proof)
            target = None if goal.report is None else goal.report.target(max(goal.report.point, 0))
            outcome = goal.outcome
        if outcome is None:
            outcome = outcome_of(view.manipulator, message, measured, context)
            words, succeeded = [outcome.message], outcome.status == "succeeded"
            if succeeded and (why := why_not_as_planned(planned, context.proof, message.switches, context.homed)):
                words.append(why)
            if succeeded and not message.verified:
                words.append("commanded, not verified")
            outcome = outcome._replace(message="; ".join(words))
        view.ended(outcome.sentence)
        result = result_of(view.manipulator, message, measured, context, outcome, target)
        accepted = AcceptanceEntry(context.id, context.sent, context.waypoints)
        self._tell(Untold(identity, message.result, accepted, result), goal)

    def lost(self, identity: Identity, data: bytes, outcome: GoalOutcome, switches: int, goal: Goal | None) -> None:
        """Ends a program that the executor no longer reports; `goal`: None if of an earlier process."""
        context, manipulator = decode_context(data) or Context("unknown"), self._view.manipulator
        unknown = bytes((len(manipulator.actuators) + 7) // 8)
        silent = Ended(0, identity.program, b"", "aborted", outcome.message, -1, switches, unknown, unknown)
        result = result_of(manipulator, silent, self._view.measured, context, outcome, None)
        accepted = AcceptanceEntry(context.id, context.sent, context.waypoints)
        self._tell(Untold(identity, None, accepted, result), goal)

    def met(self, instance: int) -> None:
        """Ends, as lost, the results that earlier executors owed, because another executor has come.

        The new executor sends its stored results, or still runs these goals. `end_unsent` ends the others.
        """
        self._met_at = self._moment.now
        self._end_owed([identity for identity in self._owed if identity.instance != instance])

    def end_unsent(self, running: int) -> None:
        """Ends, after a pause, owed programs of the present executor that it has neither sent nor runs.

        An earlier planner process acknowledged their results without recording them: the disk was full. `running` is
        the number of the program that the executor runs; -1 if none.
        """
        if self._owed and self._moment.now > self._met_at + SENT_AGAIN_WITHIN:
            now = Identity(self._view.instance or 0, running)
            self._end_owed([identity for identity in self._owed if identity != now])

    def _end_owed(self, over: list[Identity]) -> None:
        for identity in over:
            goal, mark = self._owed[identity]
            context = msgspec.msgpack.encode(Context(goal.goal, goal.waypoints, sent=goal.wall))
            outcome = self._told_outcome(identity) or GoalOutcome("lost", codes.PATH_TOLERANCE_VIOLATED, LOST)
            self.lost(identity, context, outcome, 0 if mark is None else mark.switches, None)

    def _told_outcome(self, identity: Identity) -> GoalOutcome | None:
        """Returns the outcome that an earlier planner process has published, if any; clients may have missed it."""
        owed = self._owed.get(identity)
        mark = None if owed is None else owed.published
        return None if mark is None else GoalOutcome(mark.status, mark.code, mark.message)

    # --- published, recorded, acknowledged

    def published(self, number: int) -> None:
        if (untold := self._on_way.pop(number, None)) is not None:
            self._record(untold)

    def recorded(self, entry: int) -> None:
        """Acknowledges a recorded result."""
        untold = self._on_way.pop(entry, None)
        if untold is not None and untold.number is not None and untold.identity.instance == self._view.instance:
            self._act(ToExecutor(Acknowledge(untold.number)))

    def _tell(self, untold: Untold, goal: Goal | None) -> None:
        owed = self._owed.pop(untold.identity, None)
        if untold.identity in self._told:
            self._record(untold)
            return
        self._told.add(untold.identity)
        if owed is not None and owed.published is not None:
            untold.result = msgspec.structs.replace(untold.result, repeated=True)
        number, result = self.next_entry(), untold.result
        self._on_way[number] = untold
        publication = events.PublishResult(number, untold.identity, goal is None, result)
        if goal is None or goal.unrecorded is None:
            self._act(publication)
        else:
            goal.publication = publication
        text = f"goal {result.id} {result.status}: {result.message}"
        self._act(Log(logging.INFO, text, fields_of_result(result.id or "", result.status, result.code)))

    def _record(self, untold: Untold) -> None:
        told, number = untold.result, self.next_entry()
        self._on_way[number] = untold
        entry = ResultEntry(self._moment.wall, told.status, told.code, told.message, told.switches)
        self._act(events.Record(number, untold.identity, untold.accepted, entry))


def decode_context(data: bytes) -> Context | None:
    """Returns the context in a result; None if it cannot be decoded, as from another version of the planner."""
    try:
        context: Context = decode_packed(data, Context)
    except Unreadable:
        return None
    return context


# --- the outcome, and the result


def outcome_of(manipulator: Manipulator, ended: Ended, measured: Measured, context: Context) -> GoalOutcome:
    target, goal = context.target, f"goal {context.id} was"
    if ended.status != "done":
        code = codes.PATH_TOLERANCE_VIOLATED if ended.status == "aborted" else codes.INVALID_GOAL
        return GoalOutcome(ended.status, code, ended.message)
    if target is None:
        apart = [manipulator.actuators[k] for k, state in sorted(context.jogged.items()) if measured[k] != state]
        if not apart:
            return GoalOutcome("succeeded", codes.SUCCESSFUL, "switched", "holding; the actuators were switched")
        message = f"not measured in the requested state: {', '.join(apart)}"
        return GoalOutcome("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; {message}")
    where = measured_pose(manipulator, measured, target)
    error, angle = where["error"], where["orientation_error"]
    if target.configuration is not None:
        reached = where["configuration"] == target.configuration
        found = where["configuration"] or "unknown"
        message = f"the measured configuration is {found}, not {target.configuration}"
    else:
        reached = error is not None and error <= target.tolerance
        reached = reached and (angle is None or angle <= target.angle_tolerance)
        away = "unknown" if error is None else f"{error:.4f} from the last waypoint"
        message = f"the measured tip is {away}, tolerance {target.tolerance:g}"
        if angle is not None:
            tolerances = f"tolerances {target.tolerance:g} and {target.angle_tolerance:g}"
            message = f"the measured tip is {away} and turned {angle:.4f} rad, {tolerances}"
    if reached:
        return GoalOutcome("succeeded", codes.SUCCESSFUL, "reached", f"holding; {goal} reached")
    return GoalOutcome("aborted", codes.GOAL_TOLERANCE_VIOLATED, message, f"holding; {goal} missed: {message}")


def why_not_as_planned(planned: PlanProof | None, improved: PlanProof | None, switches: int, homed: int) -> str:
    """Returns what homing added, or why a goal needed more or fewer switches than its answer said; "" if neither.

    `planned` is the plan when the goal was accepted; None for a jog. `improved` is the present plan; None: unknown.
    """
    if planned is None:
        return ""
    told = planned.switches + homed
    if switches == told:
        return f"{switches} switches, {homed} of them to home actuators of unknown position" if homed else ""
    if improved != planned:
        why = "the plan was improved while the arm moved"
    elif switches < told:
        why = "stages that were late were joined"
    else:
        why = "actuators that were not in their expected states were switched, too"
        if homed:
            why = "pulses that were not confirmed were given again, or actuators were not in their expected states"
    return f"{switches} switches instead of {told}{f', {homed} of them to home actuators' if homed else ''}: {why}"


def result_of(
    manipulator: Manipulator,
    ended: Ended,
    measured: Measured,
    context: Context,
    outcome: GoalOutcome,
    target: GoalTarget | None,
) -> Result:
    """Returns the result of a goal or jog.

    The certificate belongs to the plan from where the goal began. It is valid only if the arm did exactly the planned
    switches; otherwise `certificate` is "unknown". Errors are relative to `target`, if there is one.
    """
    proof, labels = context.proof, manipulator.actuators
    result = Result(
        id=context.id,
        status=outcome.status,
        code=outcome.code,
        message=outcome.message,
        switches=ended.switches,
        **measured_pose(manipulator, measured, target),
        bias=UNSET if context.bias is None else context.bias,
    )
    if context.jogged or not context.position:
        travels = [Travel(labels[it.actuator], STATES[it.state], it.seconds) for it in ended.travels]
        return msgspec.structs.replace(result, travels=travels)
    as_planned = proof if outcome.status == "succeeded" and proof and proof.switches == ended.switches else None
    kind = "unknown" if as_planned is None else as_planned.certificate
    known = kind in ("optimal", "bound")
    return msgspec.structs.replace(
        result,
        planned_switches=None if proof is None else proof.switches,
        optimal=kind == "optimal" if known else None,
        lower_bound=as_planned.bound if as_planned is not None and known else None,
        certificate=kind,
    )
