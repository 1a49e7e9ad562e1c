"""Queries that move nothing: plans of goals, and the live part of the arm's description."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.goal import GoalMessage
from controller.planning.core.arm import no_motion
from controller.planning.core.events import Reply, Request
from controller.planning.core.messages import CLOSING, refused
from controller.planning.core.parts import Parts
from controller.planning.core.tasks import Answer, Described, DescribePlan, Refused

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Bias = Callable[[float], "NDArray[np.float64] | None"]  # returns the tip bias at a time [s]

MOST_WAITING = 4
LONGEST = 10.0  # [s] for one query, without its time in the queue


class Queries:
    """Answers `plan` queries, each once.

    Args:
        parts: of the core.
        bias: returns the tip bias that corrects goals; None: no tracker.
        name: of this process, in the ids of goals.
    """

    def __init__(self, parts: Parts, bias: Bias, name: str) -> None:
        self._parts, self._locks, self._obstacles, self._bias, self._name = (
            parts,
            parts.locks,
            parts.obstacles,
            bias,
            name,
        )
        self._waiting: dict[int, tuple[Request, str, int | None]] = {}  # by request: content, id of the goal, task

    @property
    def waiting(self) -> int:
        """Number of queries that are not answered yet."""
        return len(self._waiting)

    def submit(self, request: Request) -> None:
        """Takes a query, or refuses it at once."""
        message = request.message
        assert isinstance(message, GoalMessage)
        goal = message.id or f"{self._name}{request.number:x}"
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
            self._parts.jobs.abandon(job, self._parts.moment.now)
            self._answer(request.number, refused(INVALID_GOAL, CLOSING, goal))

    def _task(self, request: Request, goal: str) -> DescribePlan:
        """Returns the task of a query.

        Raises:
            Refusal: the arm's state is not known, or its tables are being rebuilt.
        """
        state, tables, scene = self._parts.view.state, self._locks.tables, self._obstacles.scene
        if state is None or tables is None or (state.configuration is None and state.unknown_state is None):
            raise no_motion(*self._locks.mode())
        if state.unknown_state is not None:
            words = f"unknown state: {state.unknown_state}; switch single actuators with `jog`"
            raise Refusal(INVALID_GOAL, words)
        assert scene is not None
        bias = self._bias(self._parts.moment.now)
        numbers = None if bias is None else tuple(bias.tolist())
        message = request.message
        assert isinstance(message, GoalMessage)
        return DescribePlan(goal, message, request.wall, state.start, numbers, tables, scene, LONGEST)

    def _answered(self, request: int, goal: str, answer: Answer, last: bool, now: float) -> None:
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
