"""Requests that the executor answers: cancel, stop, reset and locks. None of them waits for a search."""

from __future__ import annotations

from controller.motion.codes import INVALID_GOAL, Refusal
from controller.planning.core.arm import no_motion
from controller.planning.core.events import CancelMessage, LockMessage, Reply, Request, ToExecutor
from controller.planning.core.goals import Goals
from controller.planning.core.messages import done, refused
from controller.planning.core.parts import Parts
from controller.program import Answer, Cancel, Down, Lock, Reset

CANCELED = "canceled; the arm holds"
PATIENCE = 2.0  # [s] for an answer, after which the executor counts as silent


class ExecutorRequests:
    """Requests that the executor answers; the request's number is the number of the executor's request.

    Args:
        parts: of the core.
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

    def answered(self, message: Answer) -> None:
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
