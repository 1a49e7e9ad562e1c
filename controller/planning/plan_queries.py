"""Answers `plan` queries in a thread with a solver of its own, so that goals never wait for them."""

import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass

from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.goal import GoalMessage
from controller.motion.whole import first_time, look_ahead
from controller.planning.goal_planning import GoalPlanning
from controller.planning.messages import CLOSING, Reply
from controller.planning.request_queue import RequestQueue
from controller.planning.workers.descriptions import payload_of

MOST_WAITING = 4
DEADLINE = 10.0  # [s] for one query, without its time in the queue


@dataclass(frozen=True, eq=False)
class PlanQuery:
    """A goal to plan but not to run; `received` is the time of arrival [UNIX s]."""

    reply: Reply
    message: GoalMessage
    received: float
    goal: str | None


class PlanQueries:
    """Answers each query once.

    Attributes:
        requests: the waiting queries.

    Args:
        planning: makes the plans; not shared.
        busy: returns whether a goal waits to be planned; the search over the whole trajectory then ends early.
    """

    def __init__(self, planning: GoalPlanning, busy: Callable[[], bool]) -> None:
        self._planning, self._busy = planning, busy
        self.requests = RequestQueue("plan queries", MOST_WAITING, self._serve)

    def submit(self, payload: bytes, reply: Reply) -> None:
        """Queues a query, or refuses it at once. Never waits."""
        self.requests.submit(lambda: self._query(payload, reply), reply)

    def _query(self, payload: bytes, reply: Reply) -> PlanQuery:
        """Decodes a query.

        Raises:
            Refusal: the query is malformed, or far out of reach.
        """
        message = self._planning.read(payload)
        return PlanQuery(reply, message, time.time(), message.id or uuid.uuid4().hex[:12])

    def _serve(self, query: PlanQuery) -> None:
        until = time.monotonic() + DEADLINE

        def proceed() -> None:
            if self.requests.closing:
                raise Refusal(codes.INVALID_GOAL, CLOSING)
            if time.monotonic() > until:
                raise Refusal(codes.INVALID_GOAL, f"planning took longer than {DEADLINE:g} s: ask for fewer waypoints")

        def hurry() -> bool:
            return self.requests.closing or self._busy() or self.requests.waiting() > 0

        trajectory = self._planning.trajectory(query.message, query.received)
        found = self._planning.plan(trajectory, proceed, run=False, seconds=first_time(trajectory))
        plan = found.plan
        if self._planning.arm.settings.method == "minimum-switch":
            plan = look_ahead(found.solver, plan, found.previous, self._planning.pace, stop=hurry)
        reduced = found.solver.manipulator
        query.reply(payload_of(self._planning.arm.manipulator, reduced, found.previous, plan))
