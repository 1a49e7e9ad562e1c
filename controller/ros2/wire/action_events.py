"""Events and actions of an action server's core, as plain data."""

from enum import IntEnum
from typing import Any, NamedTuple


class Status(IntEnum):
    """States of a goal; UNKNOWN is that of a goal that was not accepted, or is forgotten."""

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
    """A client sent a goal. `request` numbers the request, `goal` is handed back in actions."""

    request: int
    uuid: bytes
    goal: Any


class GoalRestored(NamedTuple):
    """A server before this one had accepted this goal, at `stamp` [ns since 1970]; `result`: of an ended goal."""

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
    """The program executes or ends a goal; `result` is None if it does not end."""

    uuid: bytes
    status: Status
    result: Any = None


class FeedbackGiven(NamedTuple):
    """The program has feedback on a goal."""

    uuid: bytes
    feedback: Any


class CancelRequested(NamedTuple):
    """A client wants one goal canceled, all goals (zeros), or all that were accepted until `stamp` [ns since 1970]."""

    request: int
    uuid: bytes
    stamp: int


class CancelDecided(NamedTuple):
    """The program lets these goals of a cancel request be canceled."""

    request: int
    uuids: tuple[bytes, ...]


class ResultRequested(NamedTuple):
    """A client asks for the result of a goal."""

    request: int
    uuid: bytes


class ServerClosed(NamedTuple):
    """The server ends. Goals that are not decided are rejected, active ones aborted with this result."""

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
    """A goal as clients see it: id, time of acceptance [ns since 1970] and state."""

    uuid: bytes
    stamp: int
    status: Status


class AskGoal(NamedTuple):
    """Ask the program whether it accepts a goal."""

    goal: Any


class AnswerGoal(NamedTuple):
    """Answer a goal's request."""

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
    """Tell the program that a goal is canceling."""

    goal: Any


class AnswerResult(NamedTuple):
    """Answer a request for a result; the result is None if the goal is unknown."""

    request: int
    status: Status
    result: Any


class PublishStatus(NamedTuple):
    """Publish the states of all accepted goals."""

    goals: tuple[GoalInfo, ...]


class PublishFeedback(NamedTuple):
    """Publish feedback on a goal."""

    uuid: bytes
    feedback: Any


Action = (
    AskGoal | AnswerGoal | AskCancel | AnswerCancel | TellCanceling | AnswerResult | PublishStatus | PublishFeedback
)
