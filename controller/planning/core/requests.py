"""Requests that wait for no motion: cancel, stop, reset and locks, which the executor answers, and plans of goals."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.goal import GoalMessage
from controller.planning.core.arm import no_motion, obstruction
from controller.planning.core.events import (
    CLOSING,
    CancelMessage,
    LockMessage,
    Reply,
    Request,
    ToExecutor,
    done,
    refused,
)
from controller.planning.core.goals import Goals
from controller.planning.core.parts import Parts
from controller.planning.core.tasks import Answer, Described, DescribePlan, Refused
from controller.program import Answer as ExecutorAnswer
from controller.program import Cancel, Down, Lock, Reset

if TYPE_CHECKING:
    pass

MOST_WAITING = 4
LONGEST = 10.0  # [s] for one query, without its time in the queue
CANCELED = "canceled; the arm holds"
PATIENCE = 2.0  # [s] for an answer, after which the executor counts as silent


class ExecutorRequests:
    """Requests that the executor answers; the request's number is the number of the executor's request.

    Args:
        goals: waiting goals.
    """

    def __init__(self, parts: Parts, goals: Goals) -> None:
        self._parts, self._view, self._act = parts, parts.view, parts.act
        self._locks, self._goals, self._programs = parts.locks, goals, parts.programs
        self._pending: dict[int, float] = {}  # time of each request that is not answered yet [s]

    def take(self, request: Request) -> None:
        """Takes a cancel, stop, reset or lock."""
        match request.key, request.message:
            case "cancel", CancelMessage(str(goal)):
                self._cancel_goal(request.number, goal)
            case "cancel" | "stop", _:  # the gateway has sent it
                self._parts.admission.bar(request.number)
                self._expect(request.number)
            case "reset", _:
                self._reset(request.number)
            case _, LockMessage() as message:
                self._lock(request.number, message)

    def unsent(self, number: int, reason: str) -> None:
        """Refuses a request that could not be sent."""
        self._finish(number, refused(INVALID_GOAL, f"the executor is not connected: {reason}"))

    def answered(self, message: ExecutorAnswer) -> None:
        """Passes the executor's answer on."""
        text = message.message
        self._finish(message.request, done(text) if message.accepted else refused(INVALID_GOAL, text))

    def lost(self, reason: str) -> None:
        """Refuses all requests that are not answered: the connection is lost."""
        for number in list(self._pending):
            words = f"the connection to the executor was lost before it answered: {reason}"
            self._finish(number, refused(INVALID_GOAL, words))

    def overdue(self) -> bool:
        """Returns whether the executor has not answered a request in time."""
        return any(self._parts.moment.now > at + PATIENCE for at in self._pending.values())

    def _cancel_goal(self, number: int, goal: str) -> None:
        running = self._programs.running(goal)
        if running is not None:
            self._expect(number)
            self._send(number, Cancel(number, running.program.program, CANCELED))
        elif self._goals.cancel(goal):
            self._act(Reply(number, done("canceled before it began")))
        else:
            self._act(Reply(number, done(f"goal {goal} is not running")))

    def _reset(self, number: int) -> None:
        if self._locks.problem is not None:
            self._locks.retry()
        admission = self._parts.admission
        needed = self._view.mode()[0] in ("fault", "stopped")  # otherwise earlier requests may continue
        (admission.bar if needed else admission.fence)(number)
        self._expect(number)
        self._send(number, Reset(number))

    def _lock(self, number: int, message: LockMessage) -> None:
        state = self._view.state
        try:
            if state is None:
                raise no_motion(*self._locks.mode())
            actuator = self._locks.actuator(message, state)
        except Refusal as refusal:
            self._act(Reply(number, refused(refusal.code, str(refusal))))
            return
        self._parts.admission.fence(number)
        self._expect(number)
        self._send(number, Lock(number, actuator, -1 if message.state is None else message.state))

    def _expect(self, number: int) -> None:
        self._pending[number] = self._parts.moment.now

    def _send(self, number: int, message: Down) -> None:
        if self._view.connected:
            self._act(ToExecutor(message))
        else:
            self.unsent(number, self._view.problem)

    def _finish(self, number: int, payload: object) -> None:
        if self._pending.pop(number, None) is not None:
            self._parts.admission.answered(number)
            self._act(Reply(number, payload))  # type: ignore[arg-type]


class Queries:
    """Answers `plan` queries, each once."""

    def __init__(self, parts: Parts) -> None:
        self._parts, self._locks, self._obstacles = parts, parts.locks, parts.obstacles
        self._waiting: dict[int, tuple[Request, str, int | None]] = {}  # by request: content, id of the goal, task

    @property
    def waiting(self) -> int:
        """Number of queries that are not answered yet."""
        return len(self._waiting)

    def submit(self, request: Request) -> None:
        """Takes a query, or refuses it at once."""
        message = request.message
        assert isinstance(message, GoalMessage)
        goal = message.id or f"{self._parts.name}{request.number:x}"
        if len(self._waiting) > MOST_WAITING:
            words = f"busy: {MOST_WAITING} plan queries are waiting already"
            self._parts.act(Reply(request.number, refused(INVALID_GOAL, words, goal)))
        else:
            self._waiting[request.number] = request, goal, None

    def advance(self) -> None:
        """Starts the queries that wait for the obstacles to be built. Call at the end of each step."""
        for request, goal, job in list(self._waiting.values()):
            if job is None and self._obstacles.scene is not None:
                try:
                    task = self._task(request, goal)
                except Refusal as refusal:
                    self._answer(request.number, refused(refusal.code, str(refusal), goal))
                else:
                    number = self._parts.jobs.start(task, partial(self._answered, request.number, goal))
                    self._waiting[request.number] = request, goal, number

    def close(self) -> None:
        """Refuses all queries: the process ends."""
        for request, goal, job in list(self._waiting.values()):
            self._parts.jobs.abandon(job)
            self._answer(request.number, refused(INVALID_GOAL, CLOSING, goal))

    def _task(self, request: Request, goal: str) -> DescribePlan:
        """Returns the task of a query.

        Raises:
            Refusal: the arm's state is not known, or its tables are being rebuilt.
        """
        state, tables, scene = self._parts.view.state, self._locks.tables, self._obstacles.scene
        if state is None or tables is None:
            raise no_motion(*self._locks.mode())
        if (words := obstruction(state, *self._locks.mode())) is not None:
            raise Refusal(INVALID_GOAL, words)
        assert scene is not None
        message = request.message
        assert isinstance(message, GoalMessage)
        return DescribePlan(goal, message, request.wall, state.start, self._parts.correction(), tables, scene, LONGEST)

    def _answered(self, request: int, goal: str, answer: Answer) -> None:
        match answer:
            case Described(payload):
                self._answer(request, payload)
            case Refused(code, reason):
                self._answer(request, refused(code, reason, goal))
            case _:
                self._answer(request, refused(INVALID_GOAL, "internal error while planning, see the journal", goal))

    def _answer(self, request: int, payload: object) -> None:
        if self._waiting.pop(request, None) is not None:
            self._parts.act(Reply(request, payload))  # type: ignore[arg-type]
