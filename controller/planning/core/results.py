"""Results: each is made, published, recorded and acknowledged, in this order, whichever planner process it began in."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from hyperbit.controller.host.journal import fields_of_result
from hyperbit.controller.host.process import Log
from hyperbit.controller.motion.stages.feed import PlanProof
from hyperbit.controller.motion.targets import GoalTarget
from hyperbit.controller.planning.core.arm import measured_states
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
from hyperbit.controller.planning.core.outcomes import STATUS_CODES, outcome_of, result_of, why_not_as_planned
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.reports import Context, GoalOutcome, decode_context
from hyperbit.controller.program import Acknowledge, Ended

if TYPE_CHECKING:
    pass

LOST = "the executor ended before it told how this goal ended; where the arm is now, `state` says"
SENT_AGAIN_WITHIN = 5.0  # [s] after its greeting, the executor has sent the results that it stores


class KnownProgram(NamedTuple):
    """What this planner process knows of a program beside its context.

    Attributes:
        outcome: its own reason to end the goal; None: the executor's reason, and the measured states decide.
        target: of the point that the arm was at; None for a jog.
        proof: of the plan as it was improved; None: nothing is proven.
        acceptance: entry of the acceptance that the ledger does not have yet; None: it has.
    """

    outcome: GoalOutcome | None
    target: GoalTarget | None
    proof: PlanProof | None
    acceptance: int | None


@dataclass(eq=False)
class Untold:
    """A result on its way.

    Attributes:
        result: number at the executor, which waits for its acknowledgement; None: the executor does not know it.
        accepted: the acceptance, for a ledger that may not have it.
    """

    identity: Identity
    result: int | None
    accepted: AcceptanceEntry | None
    payload: Payload


class Results:
    """The owner of results that are not yet acknowledged.

    A result is published once. When the executor sends it again, it is only recorded and acknowledged. A result that
    the ledger does not have, though an earlier planner process published it, may not have left that process. It is
    published again, with the field `repeated`.

    Args:
        published: results that earlier planner processes published, by program.
        owed: goals that an earlier planner process accepted, and whose results the ledger does not have.
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
        self._deferred: dict[
            int, PublishResult
        ] = {}  # by the entry of an acceptance, which the ledger must have before

    @property
    def idle(self) -> bool:
        """Whether all results were published and recorded."""
        return not self._publishing and not self._recording

    def next_entry(self) -> int:
        """Returns the number of a new entry of the ledger."""
        self._last += 1
        return self._last

    def waive(self, identity: Identity) -> None:
        """Suppresses the result of an abandoned program."""
        self._told.add(identity)

    # --- made

    def ended(self, message: Ended, known: KnownProgram | None) -> None:
        """Takes the executor's result of a program; `known` is None for a program of an earlier planner process."""
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
        manipulator = view.manipulator
        measured = measured_states(message.measured, message.known, len(manipulator.actuators))
        target = context.target if message.mark == context.last_mark else None
        outcome, planned = self._told_outcome(identity), context.proof
        if known is not None:
            context = msgspec.structs.replace(context, proof=known.proof)
            target, outcome = known.target, known.outcome
        outcome = outcome or outcome_of(manipulator, message, measured, context)
        if outcome.status == "succeeded" and (why := why_not_as_planned(planned, context.proof, message.switches)):
            outcome = outcome._replace(message=f"{outcome.message}; {why}")
        if outcome.status == "succeeded" and not message.verified:
            outcome = outcome._replace(message=f"{outcome.message}; commanded, not verified")
        payload = result_of(manipulator, message, measured, context, outcome, target)
        view.ended(outcome.sentence)
        self._tell(Untold(identity, message.result, accepted_of(context), payload), known, inherited=known is None)

    def lost(
        self, identity: Identity, context: bytes, known: KnownProgram, switches: int, *, inherited: bool = False
    ) -> None:
        """Ends a program of which the executor tells nothing any more.

        Args:
            identity: of the program.
            context: of the program.
            known: has an outcome.
            switches: as told last.
            inherited: whether an earlier planner process accepted the goal.
        """
        found, view, outcome = decode_context(context) or Context("unknown"), self._view, known.outcome
        assert outcome is not None
        size = len(view.manipulator.actuators)
        unknown = bytes((size + 7) // 8)
        silent = Ended(0, identity.program, context, "aborted", outcome.message, -1, switches, unknown, unknown)
        measured = view.measured
        payload = result_of(view.manipulator, silent, measured, found, outcome, None)
        self._tell(Untold(identity, None, accepted_of(found), payload), known, inherited=inherited)

    def met(self, instance: int) -> None:
        """Ends as lost what earlier executors owed, because another one has come.

        This executor sends the results that it stores, or runs these goals still: `check` ends the others.
        """
        self._met_at = self._moment.now
        self._end_owed([identity for identity in self._owed if identity.instance != instance])

    def check(self, running: int) -> None:
        """Ends what the present executor owes and has neither sent nor runs, once it had the time to send it.

        It had a result, which an earlier planner process acknowledged without recording it: the disk was full.

        Args:
            running: number of the program that the executor runs; -1 if none.
        """
        if self._owed and self._moment.now > self._met_at + SENT_AGAIN_WITHIN:
            now = Identity(self._view.instance or 0, running)
            self._end_owed([identity for identity in self._owed if identity != now])

    def _end_owed(self, over: list[Identity]) -> None:
        for identity in over:
            goal = self._owed.pop(identity)
            context = msgspec.msgpack.encode(Context(goal.goal, goal.waypoints, sent=goal.wall))
            outcome, mark = self._told_outcome(identity), self._doubtful.get(identity)
            known = KnownProgram(outcome or GoalOutcome("lost", STATUS_CODES["lost"], LOST), None, None, None)
            self.lost(identity, context, known, 0 if mark is None else mark.switches, inherited=True)

    def _told_outcome(self, identity: Identity) -> GoalOutcome | None:
        """Returns the outcome that an earlier planner process has published, perhaps in vain; otherwise None."""
        mark = self._doubtful.get(identity)
        return None if mark is None else GoalOutcome(mark.status, mark.code, mark.message)

    # --- published, recorded, acknowledged

    def published(self, number: int) -> None:
        """Records a result that was published."""
        if (untold := self._publishing.pop(number, None)) is not None:
            self._record(untold)

    def recorded(self, entry: int) -> None:
        """Acknowledges a result that was recorded, or publishes a result that waited for this acceptance."""
        if (publication := self._deferred.pop(entry, None)) is not None:
            self._act(publication)
        untold = self._recording.pop(entry, None)
        if untold is not None and untold.result is not None and untold.identity.instance == self._view.instance:
            self._act(ToExecutor(Acknowledge(untold.result)))

    def _tell(self, untold: Untold, known: KnownProgram | None, *, inherited: bool) -> None:
        self._owed.pop(untold.identity, None)
        if untold.identity in self._told:
            self._record(untold)
            return
        self._told.add(untold.identity)
        if self._doubtful.pop(untold.identity, None) is not None:
            untold.payload = {**untold.payload, "repeated": True}
        number = self.next_entry()
        self._publishing[number] = untold
        publication = PublishResult(number, untold.identity, inherited, untold.payload)
        if known is None or known.acceptance is None:
            self._act(publication)
        else:
            self._deferred[known.acceptance] = publication
        text = f"goal {untold.payload['id']} {untold.payload['status']}: {untold.payload['message']}"
        self._act(Log(logging.INFO, text, fields_of_result(untold.payload)))

    def _record(self, untold: Untold) -> None:
        payload, number = untold.payload, self.next_entry()
        fields = payload["status"], payload["code"], payload["message"], payload["switches"]
        self._recording[number] = untold
        self._act(Record(number, untold.identity, untold.accepted, ResultEntry(self._moment.wall, *fields)))


def accepted_of(context: Context) -> AcceptanceEntry:
    """Returns the acceptance of a goal, for a ledger that may not have it."""
    return AcceptanceEntry(context.id, context.sent, context.waypoints)
