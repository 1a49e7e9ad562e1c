"""Requests that wait for no motion: cancel, stop, reset, locks and faults for the executor, and plans of goals."""

from dataclasses import dataclass
from functools import partial

from msgspec.structs import replace

from hyperbit.controller import program
from hyperbit.controller.messages.goals import Answer, done, refused
from hyperbit.controller.motion.decoding.goal import GoalMessage
from hyperbit.controller.motion.decoding.requests import DegradeMessage, FaultMessage
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.arm import obstruction
from hyperbit.controller.planning.core.events import CancelMessage, Reply, Request, ToExecutor
from hyperbit.controller.planning.core.goal import homing_words
from hyperbit.controller.planning.core.goals import EXECUTOR_TIMEOUT, Goals
from hyperbit.controller.planning.core.parts import Parts, Pending, Ticket
from hyperbit.controller.planning.core.premises import Premises
from hyperbit.controller.planning.core.programs import Programs
from hyperbit.controller.program import Cancel, Down, Lock, PlayFault, Reset
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, no_motion

MOST_WAITING = 4
LONGEST = 10.0  # [s] for one query, without its time in the queue and its own deadline
CANCELED = "canceled; the arm holds"


@dataclass(eq=False)
class Query(Pending):
    """A request for a plan. Without a task it waits for the scene of the obstacles."""

    goal: GoalMessage
    received: float  # time of arrival [UNIX s]


class Queries:
    def __init__(self, parts: Parts, premises: Premises) -> None:
        self._parts, self._premises, self._requests = parts, premises, parts.requests

    @property
    def all(self) -> list[Query]:
        return self._requests.of(Query)

    def check(self) -> None:
        """Asserts that each query waits for its task, or for the scene; see `Core.check`."""
        idle = [query.number for query in self.all if query.job is None]
        assert len(self.all) <= MOST_WAITING + 1, f"{len(self.all)} queries wait"
        assert not idle or self._premises.obstacles.scene is None, f"queries {idle} wait for nothing"

    def queue(self, request: Request) -> None:
        assert isinstance(request.message, GoalMessage)
        query = Query(request.number, self._parts.moment.now, request.message, request.wall)
        self._requests.add(query)
        if len(self.all) > MOST_WAITING + 1:
            self._refuse(query, Refusal(Reason.BUSY, most=MOST_WAITING, what="plan queries"))

    def advance(self) -> None:
        """Starts the queries that wait for the scene of the obstacles. Call at the end of each step."""
        premises, state = self._premises, self._parts.view.state
        for query in self.all:
            if query.job is not None or premises.obstacles.scene is None:
                continue
            basis, mode = premises.basis(), premises.locks.mode()
            if state is None or basis is None:
                self._refuse(query, no_motion(*mode))
            elif (refusal := obstruction(state, *mode)) is not None:
                self._refuse(query, refusal)
            else:
                goal = tasks.PlanGoal(query.goal, query.received, premises.correction(), basis)
                task = tasks.DescribePlan(goal, LONGEST + (query.goal.deadline or 0.0))
                query.job = self._parts.jobs.start(task, partial(self._answered, query))

    def cancel(self, goal: str) -> bool:
        """Ends the query of a goal with this id; returns whether there was one."""
        query = next((query for query in self.all if query.goal.id == goal), None)
        if query is not None:
            self._refuse(query, Refusal(Reason.PLAN_CANCELED))
        return query is not None

    def end_queries(self) -> None:
        for query in self.all:
            self._refuse(query, Refusal(Reason.SHUTTING_DOWN))

    def _answered(self, query: Query, answer: tasks.Answer) -> None:
        query.job = None
        if isinstance(answer, tasks.Described):
            state, plan = self._parts.view.state, answer.plan
            if state is not None:  # the motions of actuators of unknown position come before the plan
                plan = replace(plan, message=plan.message + homing_words(state), homing=state.homed_first)
            self._requests.end(query, plan)
        else:
            self._refuse(query, tasks.refusal_of(answer))

    def _refuse(self, query: Query, refusal: Refusal) -> None:
        goal = query.goal.id or f"{self._parts.name}{query.number:x}"
        self._requests.end(query, refused(refusal, goal))


@dataclass(eq=False)
class ExecutorRequest(Pending):
    """A request that the executor answers."""

    reset: Ticket | None = None  # of a reset that waits for the epoch of its arrival


class ExecutorRequests:
    """Requests that the executor answers, each under the number of its arrival.

    A reset goes to the executor with the epoch of its arrival, so that the executor refuses it after a later stop.
    """

    def __init__(self, parts: Parts, premises: Premises, goals: Goals, programs: Programs, queries: Queries) -> None:
        self._parts, self._view, self._act = parts, parts.view, parts.act
        self._locks, self._goals, self._programs, self._queries = premises.locks, goals, programs, queries
        self._requests = parts.requests

    def receive_request(self, request: Request) -> None:
        number, admission, now = request.number, self._parts.admission, self._parts.moment.now
        match request.key, request.message:
            case "cancel", CancelMessage(str(goal)):
                self._cancel_goal(number, goal)
            case "cancel" | "stop", _:  # the gateway has sent it
                admission.bar(number)
                self._requests.add(ExecutorRequest(number, now))
            case "reset", _:
                self._locks.retry()
                self._requests.add(ExecutorRequest(number, now, admission.arrive(number)))
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
        for request in self._requests.of(ExecutorRequest):
            number, ticket = request.number, request.reset
            if ticket is None:
                continue
            if self._parts.admission.barred(ticket):
                self._finish(number, refused(Refusal(Reason.OVERTAKEN)))
            elif ticket.epoch is not None or not self._view.connected:
                self._send(number, Reset(number, ticket.epoch or 0))
            elif self._parts.moment.now > request.since + EXECUTOR_TIMEOUT:
                self._finish(number, refused(Refusal(Reason.EXECUTOR_BEHIND)))

    def unsent(self, number: int, reason: str) -> None:
        self._finish(number, refused(Refusal(Reason.NO_EXECUTOR, why=reason)))

    def answered(self, message: program.Answer) -> None:
        refusal = message.refused
        self._finish(message.request, done(message.message) if refusal is None else refused(refusal.refusal))

    def lost(self, reason: str) -> None:
        for request in self._requests.of(ExecutorRequest):
            self._finish(request.number, refused(Refusal(Reason.EXECUTOR_LOST, why=reason)))

    def overdue(self) -> bool:
        now = self._parts.moment.now
        return any(now > sent.since + EXECUTOR_TIMEOUT for sent in self._sent())

    def check(self) -> None:
        """Asserts that each request waits for an executor that is connected; see `Core.check`."""
        old = [
            sent.number for sent in self._sent() if sent.since != self._parts.moment.now
        ]  # `Unsent` follows new ones
        assert self._view.connected or not old, f"requests {old} wait without an executor"

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
        self._requests.add(ExecutorRequest(number, self._parts.moment.now))
        if self._view.connected:
            self._act(ToExecutor(message))
        else:
            self.unsent(number, self._view.problem)

    def _finish(self, number: int, answer: Answer) -> None:
        if (request := self._requests.find(ExecutorRequest, number)) is not None:
            self._parts.admission.answered(number)
            self._requests.end(request, answer)

    def _sent(self) -> list[ExecutorRequest]:
        return [request for request in self._requests.of(ExecutorRequest) if request.reset is None]
