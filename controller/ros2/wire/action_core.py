"""The core of an action server: `step(event, now) -> actions`, without clock, I/O or threads.

The states and transitions are those of rcl_action, see goal_state_machine.c and action_server.c of ros2/rcl.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from hyperbit.controller.ros2.wire.action_events import (
    Action,
    AnswerCancel,
    AnswerGoal,
    AnswerResult,
    AskCancel,
    AskGoal,
    CancelCode,
    CancelDecided,
    CancelRequested,
    Event,
    FeedbackGiven,
    GoalDecided,
    GoalInfo,
    GoalRequested,
    GoalRestored,
    PublishFeedback,
    PublishStatus,
    ResultRequested,
    ServerClosed,
    Status,
    StatusChanged,
    TellCanceling,
)

NO_UUID = bytes(16)
RESTORED = -1  # number of the request of a restored goal, which was answered before
MOST_GOALS = 64  # known at once; above this number ended goals are forgotten early
ACTIVE = (Status.ACCEPTED, Status.EXECUTING, Status.CANCELING)
CANCELABLE = (Status.ACCEPTED, Status.EXECUTING)
# Permitted earlier states by new state.
BEFORE: dict[Status, tuple[Status, ...]] = {
    Status.EXECUTING: (Status.ACCEPTED,),
    Status.SUCCEEDED: (Status.EXECUTING, Status.CANCELING),
    Status.ABORTED: (Status.EXECUTING, Status.CANCELING),
    Status.CANCELED: (Status.CANCELING,),
}


class IllegalTransition(RuntimeError):
    """The program asked for a transition that the goal's state does not allow."""


@dataclass
class Goal:
    request: int  # number of the goal's request, which the decision answers
    goal: Any
    status: Status = Status.UNKNOWN
    stamp: int = 0  # time of acceptance [ns since 1970]
    ended: float = 0.0  # on the clock of `now` [s]
    result: Any = None
    waiting: list[int] = field(default_factory=list)  # requests for the result


class ActionCore:
    """All goals of one action server, at most `most_goals`. Results are kept for `result_timeout` [s]."""

    def __init__(self, result_timeout: float = 10.0, most_goals: int = MOST_GOALS) -> None:
        self.goals: dict[bytes, Goal] = {}  # by id, in the order of their requests
        self._result_timeout, self._most_goals = result_timeout, most_goals
        self._closed = False

    def step(self, event: Event, now: float) -> list[Action]:
        """Returns the actions that follow from an event; `now` is monotonic [s].

        Raises IllegalTransition if an event of the program does not suit the goal's state. No goal has changed then.
        """
        for uuid in [uuid for uuid, goal in self.goals.items() if self._expired(goal, now)]:
            del self.goals[uuid]
        match event:
            case GoalRequested():
                return list(self._request(event))
            case GoalRestored():
                if event.uuid in self.goals:
                    raise IllegalTransition(f"goal {event.uuid.hex()} is known already")
                self.goals[event.uuid] = Goal(RESTORED, event.goal, event.status, event.stamp, now, event.result)
                return [PublishStatus(self.infos())]
            case GoalDecided():
                return list(self._decide(event))
            case StatusChanged():
                return list(self._change(event, now))
            case FeedbackGiven():
                active = self.status(event.uuid) in ACTIVE
                return [PublishFeedback(event.uuid, event.feedback)] if active else []
            case CancelRequested():
                return [self._cancel(event)]
            case CancelDecided():
                return list(self._decide_cancel(event))
            case ResultRequested():
                return list(self._ask_result(event))
            case ServerClosed():
                return list(self._close(event, now))

    def status(self, uuid: bytes) -> Status:
        return self.goals[uuid].status if uuid in self.goals else Status.UNKNOWN

    def infos(self, chosen: Callable[[Goal], bool] = lambda goal: True) -> tuple[GoalInfo, ...]:
        """Returns all accepted goals that `chosen` selects."""
        accepted = ((uuid, goal) for uuid, goal in self.goals.items() if goal.status is not Status.UNKNOWN)
        return tuple(GoalInfo(uuid, goal.stamp, goal.status) for uuid, goal in accepted if chosen(goal))

    def _expired(self, goal: Goal, now: float) -> bool:
        ended = goal.status in (Status.SUCCEEDED, Status.CANCELED, Status.ABORTED)
        return ended and now - goal.ended > self._result_timeout

    def _request(self, event: GoalRequested) -> Iterator[Action]:
        if len(self.goals) >= self._most_goals:
            ended = [it for it, goal in self.goals.items() if goal.status > Status.CANCELING]
            if ended:
                del self.goals[min(ended, key=lambda it: self.goals[it].ended)]
        if self._closed or event.uuid in self.goals or len(self.goals) >= self._most_goals:
            yield AnswerGoal(event.request, accepted=False)
            return
        self.goals[event.uuid] = Goal(event.request, event.goal)
        yield AskGoal(event.goal)

    def _decide(self, event: GoalDecided) -> Iterator[Action]:
        goal = self.goals.get(event.uuid)
        if goal is None or goal.status is not Status.UNKNOWN:
            raise IllegalTransition(f"goal {event.uuid.hex()} does not wait for a decision")
        if not event.accepted:
            del self.goals[event.uuid]
            yield AnswerGoal(goal.request, accepted=False)
            return
        goal.status, goal.stamp = Status.ACCEPTED, event.stamp
        yield AnswerGoal(goal.request, accepted=True, stamp=goal.stamp)
        yield PublishStatus(self.infos())

    def _change(self, event: StatusChanged, now: float) -> Iterator[Action]:
        old = self.status(event.uuid)
        if event.status is Status.EXECUTING and old is Status.CANCELING:
            return  # a cancel came between acceptance and execution; the program need not know
        if old not in BEFORE[event.status]:
            raise IllegalTransition(f"goal {event.uuid.hex()} is {old.name}, it cannot become {event.status.name}")
        goal = self.goals[event.uuid]
        if event.status is Status.EXECUTING:
            goal.status = event.status
        else:
            yield from self._end(goal, event.status, event.result, now)
        yield PublishStatus(self.infos())

    def _end(self, goal: Goal, status: Status, result: Any, now: float) -> Iterator[Action]:
        goal.status, goal.result, goal.ended = status, result, now
        waiting, goal.waiting = goal.waiting, []
        for request in waiting:
            yield AnswerResult(request, status, result)

    def _cancel(self, event: CancelRequested) -> Action:
        """Asks the program which goals may be canceled, or answers if there are none."""
        status = self.status(event.uuid)
        if event.uuid != NO_UUID and event.stamp == 0:
            if status is Status.UNKNOWN:
                return AnswerCancel(event.request, CancelCode.UNKNOWN_GOAL)
            if status not in CANCELABLE:
                return AnswerCancel(event.request, CancelCode.TERMINATED)
            return AskCancel(event.request, (self.goals[event.uuid].goal,))
        everything = event.uuid == NO_UUID and event.stamp == 0
        goals = tuple(
            goal.goal
            for uuid, goal in self.goals.items()
            if goal.status in CANCELABLE and (everything or goal.stamp <= event.stamp or uuid == event.uuid)
        )
        return AskCancel(event.request, goals) if goals else AnswerCancel(event.request, CancelCode.NONE)

    def _decide_cancel(self, event: CancelDecided) -> Iterator[Action]:
        chosen = [uuid for uuid in event.uuids if self.status(uuid) in CANCELABLE]
        for uuid in chosen:
            self.goals[uuid].status = Status.CANCELING
        code = CancelCode.NONE if chosen else CancelCode.TERMINATED if event.uuids else CancelCode.REJECTED
        infos = tuple(GoalInfo(uuid, self.goals[uuid].stamp, Status.CANCELING) for uuid in chosen)
        yield AnswerCancel(event.request, code, infos)
        if chosen:
            yield PublishStatus(self.infos())
        for uuid in chosen:
            yield TellCanceling(self.goals[uuid].goal)

    def _ask_result(self, event: ResultRequested) -> Iterator[Action]:
        goal = self.goals.get(event.uuid)
        if goal is None or goal.status is Status.UNKNOWN:
            yield AnswerResult(event.request, Status.UNKNOWN, None)
        elif goal.status in ACTIVE:
            goal.waiting.append(event.request)
        else:
            yield AnswerResult(event.request, goal.status, goal.result)

    def _close(self, event: ServerClosed, now: float) -> Iterator[Action]:
        self._closed = True
        for uuid, goal in list(self.goals.items()):
            if goal.status is Status.UNKNOWN:
                yield from self._decide(GoalDecided(uuid, accepted=False, stamp=0))
        active = [goal for goal in self.goals.values() if goal.status in ACTIVE]
        for goal in active:
            yield from self._end(goal, Status.ABORTED, event.result, now)
        if active:
            yield PublishStatus(self.infos())
