"""The answers to requests, and the messages on `feedback`, `result` and `@request`."""

from typing import Any

from msgspec import UNSET, Struct, UnsetType

from hyperbit.controller.messages.parts import Code, Count, Number, Orientation, Position, Stamp
from hyperbit.controller.refusals import codes
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal


class Answer(Struct, frozen=True):
    """The answer to a request, except to `arm`."""

    accepted: bool
    message: str
    id: str | UnsetType | None = UNSET  # of the goal; null: of a refused request that has none
    code: Code = 0
    reason: str | UnsetType = UNSET  # of a refusal
    homing: list[str] | UnsetType = UNSET  # actuators of unknown position, which a goal homes first


def done(message: str) -> Answer:
    return Answer(accepted=True, code=codes.SUCCESSFUL, message=message)


def refused(refusal: Refusal, goal: str | None = None) -> Answer:
    """Returns the answer to a refused request. `goal`: id of the refused goal; needed if the refusal has none."""
    name, reason = refusal.goal if goal is None else goal, refusal.reason.value
    return Answer(accepted=False, id=name, code=refusal.code, reason=reason, message=str(refusal))


class Measured(Struct, frozen=True):
    """Where the arm is, and its distance [length] and angle [rad] from a target; None: unknown."""

    configuration: str | None = None
    position: Position | None = None
    orientation: Orientation | None = None
    error: Number | None = None
    orientation_error: Number | None = None


class Feedback(Measured, frozen=True):
    """The arm has settled at a waypoint."""

    id: str | None = None
    waypoint: Count | None = None
    waypoints: Count | None = None
    switches: Count = 0
    stages: Count = 0
    excursion: Number | None = None
    remaining: Number = 0.0  # [s]
    bias: list[Number] | UnsetType = UNSET


class GoalEnd(Struct, frozen=True):
    """How a goal has ended: an entry of the ledger; or the refusal of a put, which has no answer."""

    status: str
    id: str | None = None
    code: Code = codes.INVALID_GOAL
    message: str = ""
    switches: Count | UnsetType = UNSET
    accepted: bool | UnsetType = UNSET
    reason: str | UnsetType = UNSET


class Travel(Struct, frozen=True):
    """A travel to an end-stop."""

    actuator: str
    state: str
    seconds: Number


class Result(GoalEnd, frozen=True):
    """The end of a goal or jog. The plan's fields are of a goal, `travels` of a jog."""

    switches: Count = 0
    configuration: str | None = None
    position: Position | None = None
    orientation: Orientation | None = None
    error: Number | None = None
    orientation_error: Number | None = None
    planned_switches: Count | UnsetType | None = UNSET
    optimal: bool | UnsetType | None = UNSET
    lower_bound: Number | UnsetType | None = UNSET
    certificate: str | UnsetType = UNSET
    travels: list[Travel] | UnsetType = UNSET
    bias: list[Number] | UnsetType = UNSET
    repeated: bool | UnsetType = UNSET  # an earlier process may have published it


class PlanPoint(Measured, frozen=True):
    """A point of a plan: where the arm would be, and the switches on the way to it."""

    t: Number = 0.0
    goal: Position | None = None
    between: bool = False  # on a line between waypoints
    switches: Count = 0
    seconds: Number | UnsetType = UNSET  # of the search
    effort: Number | UnsetType = UNSET  # of the search, in place of its time
    cost: Number = 0.0
    optimal: bool | None = None
    lower_bound: Number | None = None
    certificate: str = "unknown"
    stages: list[list[str]] = []  # labels of the actuators that switch together
    needed: Number = 0.0  # least time of the way to the point [s]
    excursion: Number | None = None


class Plan(Answer, frozen=True):
    """The answer to `plan` if there is one."""

    waypoints: list[PlanPoint] = []
    switches: Count = 0
    cost: Number = 0.0
    optimal: bool | None = None
    lower_bound: Number | None = None
    certificate: str = "unknown"
    bias: list[Number] | UnsetType = UNSET


class LedgerAnswer(Answer, frozen=True):
    """The answer to `result` for a goal that the ledger has."""

    result: GoalEnd | None = None  # None: the goal has not ended


class Note(Struct, frozen=True):
    """A request that the daemon has answered."""

    key: str
    answer: Answer
    stamp: Stamp = 0.0
    payload: Any = None
    text: str | UnsetType = UNSET  # of a payload that is no JSON


def internal_error(goal: str | None = None) -> Answer:
    return refused(Refusal(Reason.INTERNAL_ERROR), goal)
