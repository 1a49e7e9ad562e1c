"""Results: each is made, published, recorded and acknowledged, in this order, whichever planner process it began in."""

import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import msgspec

from hyperbit.controller.host.journal import fields_of_result
from hyperbit.controller.host.process import Log
from hyperbit.controller.planning.core.events import (
    AcceptanceEntry,
    Identity,
    OpenGoal,
    Payload,
    PublishResult,
    Record,
    ResultEntry,
    ToExecutor,
)
from hyperbit.controller.planning.core.goal import Goal
from hyperbit.controller.planning.core.outcomes import STATUS_CODES, outcome_of, result_of, why_not_as_planned
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.reports import Context, GoalOutcome, decode_context
from hyperbit.controller.program import Acknowledge, Ended

LOST = "the executor ended before it told how this goal ended; where the arm is now, `state` says"
SENT_AGAIN_WITHIN = 5.0  # [s] after its greeting, the executor has sent the results that it stores


@dataclass(eq=False)
class Untold:
    """A result on its way."""

    identity: Identity
    result: int | None  # number at the executor, which waits for its acknowledgement; None: it does not know the result
    accepted: AcceptanceEntry  # for a ledger that may not have it
    payload: Payload


class Results:
    """The owner of results that are not yet acknowledged.

    A result is published once. When the executor sends it again, it is only recorded and acknowledged. A result that
    the ledger does not have, though an earlier planner process published it, may not have left that process. It is
    published again, with the field `repeated`. `owed` are goals whose results the ledger does not have.
    """

    def __init__(self, parts: Parts, published: Mapping[Identity, ResultEntry], owed: Iterable[OpenGoal]) -> None:
        self._view, self._moment, self._act = parts.view, parts.moment, parts.act
        self._owed = {goal.identity: goal for goal in owed}
        self._doubtful = {identity: mark for identity, mark in published.items() if identity in self._owed}
        self._told = published.keys() - self._owed.keys()
        self._met_at = math.inf  # when the present executor was met [s]
        self._last = 0  # number of a publication or of an entry of the ledger
        self._publishing: dict[int, Untold] = {}
        self._recording: dict[int, Untold] = {}
        self._deferred: dict[int, PublishResult] = {}  # by entry of the acceptance, which the ledger must have before

    @property
    def idle(self) -> bool:
        return not self._publishing and not self._recording

    def next_entry(self) -> int:
        self._last += 1
        return self._last

    def waive(self, identity: Identity) -> None:
        """Suppresses the result of an abandoned program."""
        self._told.add(identity)

    # --- made

    def ended(self, message: Ended, goal: Goal | None) -> None:
        """Takes the executor's result of a program; `goal` is None for a program of an earlier planner process."""
        context, view = decode_context(message.context), self._view
        identity = Identity(view.instance or 0, message.program)
        for untold in (*self._publishing.values(), *self._recording.values()):
            if untold.identity == identity:  # on its way; the executor waits for its acknowledgement
                untold.result = message.result
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
            target, outcome = goal.report.present, goal.outcome
        outcome = outcome or outcome_of(view.manipulator, message, measured, context)
        if outcome.status == "succeeded" and (why := why_not_as_planned(planned, context.proof, message.switches)):
            outcome = outcome._replace(message=f"{outcome.message}; {why}")
        if outcome.status == "succeeded" and not message.verified:
            outcome = outcome._replace(message=f"{outcome.message}; commanded, not verified")
        payload = result_of(view.manipulator, message, measured, context, outcome, target)
        view.ended(outcome.sentence)
        self._tell(Untold(identity, message.result, accepted_of(context), payload), goal)

    def lost(
        self, identity: Identity, context: bytes, outcome: GoalOutcome, switches: int, goal: Goal | None = None
    ) -> None:
        """Ends a program of which the executor tells nothing any more; `goal`: None if of an earlier process."""
        found, manipulator = decode_context(context) or Context("unknown"), self._view.manipulator
        unknown = bytes((len(manipulator.actuators) + 7) // 8)
        silent = Ended(0, identity.program, context, "aborted", outcome.message, -1, switches, unknown, unknown)
        payload = result_of(manipulator, silent, self._view.measured, found, outcome, None)
        self._tell(Untold(identity, None, accepted_of(found), payload), goal)

    def met(self, instance: int) -> None:
        """Ends as lost what earlier executors owed, because another one has come.

        This executor sends the results that it stores, or runs these goals still: `check` ends the others.
        """
        self._met_at = self._moment.now
        self._end_owed([identity for identity in self._owed if identity.instance != instance])

    def check(self, running: int) -> None:
        """Ends what the present executor owes and has neither sent nor runs, once it had the time to send it.

        It had a result, which an earlier planner process acknowledged without recording it: the disk was full.
        `running` is the number of the program that the executor runs; -1 if none.
        """
        if self._owed and self._moment.now > self._met_at + SENT_AGAIN_WITHIN:
            now = Identity(self._view.instance or 0, running)
            self._end_owed([identity for identity in self._owed if identity != now])

    def _end_owed(self, over: list[Identity]) -> None:
        for identity in over:
            goal = self._owed.pop(identity)
            context = msgspec.msgpack.encode(Context(goal.goal, goal.waypoints, sent=goal.wall))
            mark = self._doubtful.get(identity)
            outcome = self._told_outcome(identity) or GoalOutcome("lost", STATUS_CODES["lost"], LOST)
            self.lost(identity, context, outcome, 0 if mark is None else mark.switches)

    def _told_outcome(self, identity: Identity) -> GoalOutcome | None:
        """Returns the outcome that an earlier planner process has published, perhaps in vain; otherwise None."""
        mark = self._doubtful.get(identity)
        return None if mark is None else GoalOutcome(mark.status, mark.code, mark.message)

    # --- published, recorded, acknowledged

    def published(self, number: int) -> None:
        if (untold := self._publishing.pop(number, None)) is not None:
            self._record(untold)

    def recorded(self, entry: int) -> None:
        """Acknowledges a result that was recorded, or publishes a result that waited for this acceptance."""
        if (publication := self._deferred.pop(entry, None)) is not None:
            self._act(publication)
        untold = self._recording.pop(entry, None)
        if untold is not None and untold.result is not None and untold.identity.instance == self._view.instance:
            self._act(ToExecutor(Acknowledge(untold.result)))

    def _tell(self, untold: Untold, goal: Goal | None) -> None:
        self._owed.pop(untold.identity, None)
        if untold.identity in self._told:
            self._record(untold)
            return
        self._told.add(untold.identity)
        if self._doubtful.pop(untold.identity, None) is not None:
            untold.payload = {**untold.payload, "repeated": True}
        number = self.next_entry()
        self._publishing[number] = untold
        publication = PublishResult(number, untold.identity, goal is None, untold.payload)
        if goal is None or goal.unrecorded is None:
            self._act(publication)
        else:
            self._deferred[goal.unrecorded] = publication
        text = f"goal {untold.payload['id']} {untold.payload['status']}: {untold.payload['message']}"
        self._act(Log(logging.INFO, text, fields_of_result(untold.payload)))

    def _record(self, untold: Untold) -> None:
        payload, number = untold.payload, self.next_entry()
        fields = payload["status"], payload["code"], payload["message"], payload["switches"]
        self._recording[number] = untold
        self._act(Record(number, untold.identity, untold.accepted, ResultEntry(self._moment.wall, *fields)))


def accepted_of(context: Context) -> AcceptanceEntry:
    return AcceptanceEntry(context.id, context.sent, context.waypoints)
