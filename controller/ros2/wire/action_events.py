"""Events and actions of an action server's core, as plain data."""

from enum import IntEnum
from typing import Any, NamedTuple


class Status(IntEnum):
    """States of a goal. UNKNOWN: the goal was not accepted, or is forgotten."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


class CancelCode(IntEnum):
    """Return codes of action_msgs/srv/CancelGoal."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL = 2
    TERMINATED = 3


class GoalRequested(NamedTuple):
    """A client sent a goal. `request` numbers the request; actions hand `goal` back."""

    request: int
    uuid: bytes
    goal: Any


class GoalRestored(NamedTuple):
    """An earlier server had accepted this goal, at `stamp` [ns since 1970]; `result`: of an ended goal."""

    uuid: bytes
    goal: Any
    stamp: int
    status: Status
    result: Any = None


class GoalDecided(NamedTuple):
    """The program accepts or rejects a goal; `stamp` is the time of acceptance [ns since 1970]."""

    uuid: bytes
    accepted: bool
    stamp: int


class StatusChanged(NamedTuple):
    """The program executes or ends a goal; `result` is None unless it ends."""

    uuid: bytes
    status: Status
    result: Any = None


class FeedbackGiven(NamedTuple):
    uuid: bytes
    feedback: Any


class CancelRequested(NamedTuple):
    """A client wants one goal canceled, all goals (zeros), or all goals accepted until `stamp` [ns since 1970]."""

    request: int
    uuid: bytes
    stamp: int


class CancelDecided(NamedTuple):
    """The program allows the cancel of these goals."""

    request: int
    uuids: tuple[bytes, ...]


class ResultRequested(NamedTuple):
    request: int
    uuid: bytes


class ServerClosed(NamedTuple):
    """The server ends. It rejects undecided goals, and aborts active goals with this result."""

    result: Any


Event = (
    GoalRequested
    | GoalRestored
    | GoalDecided
    | StatusChanged
    | FeedbackGiven
    | CancelRequested
    | CancelDecided
    | ResultRequested
    | ServerClosed
)


class GoalInfo(NamedTuple):
    """A goal as clients see it; `stamp` is the time of acceptance [ns since 1970]."""

    uuid: bytes
    stamp: int
    status: Status


class AskGoal(NamedTuple):
    goal: Any


class AnswerGoal(NamedTuple):
    request: int
    accepted: bool
    stamp: int = 0


class AskCancel(NamedTuple):
    """Ask the program which of these goals may be canceled."""

    request: int
    goals: tuple[Any, ...]


class AnswerCancel(NamedTuple):
    """Answer a cancel request; `goals` are canceling now."""

    request: int
    code: CancelCode
    goals: tuple[GoalInfo, ...] = ()


class TellCanceling(NamedTuple):
    goal: Any


class AnswerResult(NamedTuple):
    """Answer a request for a result; the result is None if the goal is unknown."""

    request: int
    status: Status
    result: Any


class PublishStatus(NamedTuple):
    goals: tuple[GoalInfo, ...]


class PublishFeedback(NamedTuple):
    uuid: bytes
    feedback: Any


Action = (
    AskGoal | AnswerGoal | AskCancel | AnswerCancel | TellCanceling | AnswerResult | PublishStatus | PublishFeedback
)
