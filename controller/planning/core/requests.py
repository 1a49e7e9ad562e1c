"""Requests that wait for no motion: cancel, stop, reset, locks and faults for the executor, and plans of goals."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from hyperbit.controller.motion.decoding.goal import GoalMessage
from hyperbit.controller.motion.decoding.requests import DegradeMessage, FaultMessage
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.arm import obstruction
from hyperbit.controller.planning.core.events import CancelMessage, Payload, Reply, Request, ToExecutor, done, refused
from hyperbit.controller.planning.core.goal import homing_words
from hyperbit.controller.planning.core.goals import EXECUTOR_TIMEOUT, Goals
from hyperbit.controller.planning.core.parts import Parts, Ticket
from hyperbit.controller.planning.core.premises import Premises
from hyperbit.controller.planning.core.programs import Programs
from hyperbit.controller.program import Answer, Cancel, Down, Lock, PlayFault, Reset
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, no_motion

MOST_WAITING = 4
LONGEST = 10.0  # [s] for one query, without its time in the queue and its own deadline
CANCELED = "canceled; the arm holds"


@dataclass(eq=False)
class Query:
    """A request for a plan."""

    request: Request
    goal: GoalMessage
    job: int | None = None  # number of its task; None: it waits for the scene of the obstacles


class Queries:
    def __init__(self, parts: Parts, premises: Premises) -> None:
        self._parts, self._premises = parts, premises
        self._waiting: dict[int, Query] = {}  # by number of the request

    @property
    def waiting(self) -> int:
        return len(self._waiting)

    def awaited(self) -> list[int | None]:
        return [query.job for query in self._waiting.values()]

    def check(self) -> None:
        """Asserts that each query waits for its task, or for the scene; see `Core.check`."""
        idle = [number for number, query in self._waiting.items() if query.job is None]
        assert len(self._waiting) <= MOST_WAITING + 1, f"queries {list(self._waiting)} wait"
        assert not idle or self._premises.obstacles.scene is None, f"queries {idle} wait for nothing"

    def queue(self, request: Request) -> None:
        assert isinstance(request.message, GoalMessage)
        full = len(self._waiting) > MOST_WAITING
        query = self._waiting[request.number] = Query(request, request.message)
        if full:
            self._refuse(query, Refusal(Reason.BUSY, most=MOST_WAITING, what="plan queries"))

    def advance(self) -> None:
        """Starts the queries that wait for the scene of the obstacles. Call at the end of each step."""
        premises, state = self._premises, self._parts.view.state
        for query in list(self._waiting.values()):
            if query.job is not None or premises.obstacles.scene is None:
                continue
            basis, mode = premises.basis(), premises.locks.mode()
            if state is None or basis is None:
                self._refuse(query, no_motion(*mode))
            elif (refusal := obstruction(state, *mode)) is not None:
                self._refuse(query, refusal)
            else:
                goal = tasks.PlanGoal(query.goal, query.request.wall, premises.correction(), basis)
                task = tasks.DescribePlan(goal, LONGEST + (query.goal.deadline or 0.0))
                query.job = self._parts.jobs.start(task, partial(self._answered, query))

    def cancel(self, goal: str) -> bool:
        """Ends the query of a goal with this id; returns whether there was one."""
        query = next((query for query in self._waiting.values() if query.goal.id == goal), None)
        if query is not None:
            self._refuse(query, Refusal(Reason.PLAN_CANCELED))
        return query is not None

    def end_queries(self) -> None:
        for query in list(self._waiting.values()):
            self._refuse(query, Refusal(Reason.SHUTTING_DOWN))

    def _answered(self, query: Query, answer: tasks.Answer) -> None:
        query.job = None
        if isinstance(answer, tasks.Described):
            state, payload = self._parts.view.state, answer.payload
            if state is not None:  # the motions of actuators of unknown position come before the plan
                message = payload["message"] + homing_words(state)
                payload = {**payload, "message": message, "homing": state.homed_first}
            self._answer(query, payload)
        else:
            self._refuse(query, tasks.refusal_of(answer))

    def _refuse(self, query: Query, refusal: Refusal) -> None:
        self._parts.jobs.abandon(query.job)
        goal = query.goal.id or f"{self._parts.name}{query.request.number:x}"
        self._answer(query, refused(refusal, goal))

    def _answer(self, query: Query, payload: Payload) -> None:
        if self._waiting.pop(query.request.number, None) is not None:
            self._parts.act(Reply(query.request.number, payload))


class Pending(NamedTuple):
    """A request that the executor answers."""

    since: float  # its arrival, or when it was sent [s]
    reset: Ticket | None = None  # of a reset that waits for the epoch of its arrival


class ExecutorRequests:
    """Requests that the executor answers, each under the number of its arrival.

    A reset goes to the executor with the epoch of its arrival, so that the executor refuses it after a later stop.
    """

    def __init__(self, parts: Parts, premises: Premises, goals: Goals, programs: Programs, queries: Queries) -> None:
        self._parts, self._view, self._act = parts, parts.view, parts.act
        self._locks, self._goals, self._programs, self._queries = premises.locks, goals, programs, queries
        self._pending: dict[int, Pending] = {}  # by number of the request

    def receive_request(self, request: Request) -> None:
        number, admission, now = request.number, self._parts.admission, self._parts.moment.now
        match request.key, request.message:
            case "cancel", CancelMessage(str(goal)):
                self._cancel_goal(number, goal)
            case "cancel" | "stop", _:  # the gateway has sent it
                admission.bar(number)
                self._pending[number] = Pending(now)
            case "reset", _:
                self._locks.retry()
                self._pending[number] = Pending(now, admission.arrive(number))
                needed = self._view.mode()[0] in ("fault", "stopped")  # otherwise earlier requests may continue
                (admission.bar if needed else admission.fence)(number)
            case _, DegradeMessage() as message:
                try:
                    if (state := self._view.state) is None:
                        raise no_motion(*self._locks.mode())
                    actuator = self._locks.actuator(message, state)
                except Refusal as refusal:
                    self._act(Reply(number, refused(refusal)))
                else:
                    admission.fence(number)
                    self._send(number, Lock(number, actuator, -1 if message.state is None else message.state))
            case _, FaultMessage(fault=fault):
                if self._parts.simulated:
                    self._send(number, PlayFault(number, fault))
                else:
                    self._act(Reply(number, refused(Refusal(Reason.NOT_SIMULATED))))

    def advance(self) -> None:
        """Sends resets whose epoch is known, if no stop, cancel or fault came after. Call at the end of each step."""
        for number, (since, ticket) in list(self._pending.items()):
            if ticket is None:
                continue
            if self._parts.admission.barred(ticket):
                self._finish(number, refused(Refusal(Reason.OVERTAKEN)))
            elif ticket.epoch is not None or not self._view.connected:
                self._send(number, Reset(number, ticket.epoch or 0))
            elif self._parts.moment.now > since + EXECUTOR_TIMEOUT:
                self._finish(number, refused(Refusal(Reason.EXECUTOR_BEHIND)))

    def unsent(self, number: int, reason: str) -> None:
        self._finish(number, refused(Refusal(Reason.NO_EXECUTOR, why=reason)))

    def answered(self, message: Answer) -> None:
        refusal = message.refused
        self._finish(message.request, done(message.message) if refusal is None else refused(refusal.refusal))

    def lost(self, reason: str) -> None:
        for number in list(self._pending):
            self._finish(number, refused(Refusal(Reason.EXECUTOR_LOST, why=reason)))

    def overdue(self) -> bool:
        now = self._parts.moment.now
        return any(now > it.since + EXECUTOR_TIMEOUT for it in self._pending.values() if it.reset is None)

    def check(self) -> None:
        """Asserts that each request waits for an executor that is connected; see `Core.check`."""
        waits = {number: it.since for number, it in self._pending.items() if it.reset is None}
        new = all(since == self._parts.moment.now for since in waits.values())  # `Unsent` follows
        assert self._view.connected or new, f"requests {list(waits)} wait without an executor"

    def _cancel_goal(self, number: int, goal: str) -> None:
        """Bars all earlier requests of an id: refuses those that wait, and ends its program."""
        self._parts.admission.bar_id(goal, number)
        running = self._programs.find(goal)
        waited = any(known.id == goal and known.state == "waiting" for known in self._goals.all)
        self._goals.refuse_late()
        if running is not None:
            self._send(number, Cancel(number, running.program.program, CANCELED))
            return
        ended = "canceled before it began" if waited else "the plan is canceled" if self._queries.cancel(goal) else ""
        self._act(Reply(number, done(ended or f"goal {goal} is not running")))

    def _send(self, number: int, message: Down) -> None:
        self._pending[number] = Pending(self._parts.moment.now)
        if self._view.connected:
            self._act(ToExecutor(message))
        else:
            self.unsent(number, self._view.problem)

    def _finish(self, number: int, payload: Payload) -> None:
        if self._pending.pop(number, None) is not None:
            self._parts.admission.answered(number)
            self._act(Reply(number, payload))
