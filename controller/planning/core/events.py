"""Events and actions of the planner's core, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from hyperbit.controller.host.process import Log, Notify, Quit
from hyperbit.controller.motion.decoding.goal import GoalMessage, Jog
from hyperbit.controller.planning.core.tasks import Answer, Task
from hyperbit.controller.program import Down, Fault, Up
from hyperbit.controller.refusals import codes
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

Payload = Mapping[str, Any]


class CancelMessage(NamedTuple):
    """The payload of `cancel`: id of the goal to cancel; None cancels whatever runs, and bars all earlier requests."""

    goal: str | None = None


class LockMessage(NamedTuple):
    """The payload of `degrade`: label of an actuator, and the state to lock it in; None unlocks it."""

    actuator: str
    state: int | None


class FaultToPlay(NamedTuple):
    """The payload of `fault`: a fault to play in simulated boards, such as "silence can0/5"."""

    fault: str


class SentObstacles(NamedTuple):
    """The payload of `obstacles`: decoded for the workers, and as it came for the description of the arm."""

    obstacles: Any
    regions: list[Any]


Key = Literal["goal", "jog", "plan", "cancel", "stop", "reset", "degrade", "obstacles", "fault", "arm"]
# Keys without a content have None.
Message = GoalMessage | Jog | CancelMessage | LockMessage | SentObstacles | FaultToPlay | None


class Arrival(NamedTuple):
    """The arrival of a request, set-point or measured tip at the gateway.

    Requests may reach the core in another order: their numbers decide.

    Attributes:
        number: from 1, ascending.
        at: time of arrival [s, the monotonic clock]. What arrives just after the process stood still may have waited
            since it did.
    """

    number: int
    at: float


class Request(NamedTuple):
    """A request of a client, decoded. It is answered by exactly one `Reply`.

    A `stop`, and a `cancel` without an id, was sent to the executor before, as the executor's request of this number.

    Attributes:
        arrival: its place in the order of arrival, and its time.
        wall: time of arrival [UNIX s].
    """

    arrival: Arrival
    key: Key
    message: Message
    wall: float

    @property
    def number(self) -> int:
        """Number of the request."""
        return self.arrival.number


class Unsent(NamedTuple):
    """A `stop` or `cancel` could not be sent to the executor; comes after its `Request`."""

    number: int
    reason: str


class SetpointArrived(NamedTuple):
    """The latest set-point of one sender, as it came; `sender` is what the sender attaches, "" if nothing."""

    payload: bytes
    arrival: Arrival
    sender: str = ""


class TipArrived(NamedTuple):
    """The latest measured tip of one sender, as it came."""

    payload: bytes
    arrival: Arrival
    sender: str = ""


Arrived = SetpointArrived | TipArrived


class FromExecutor(NamedTuple):
    """A message of the executor. `Welcome` is the first one of a connection."""

    message: Up


class LinkDown(NamedTuple):
    """There is no connection to the executor, and why. The shell repeats it only if the reason changes."""

    reason: str


class Answered(NamedTuple):
    """A worker's answer to the task of a number; a task may have several answers, the last one is marked."""

    task: int
    answer: Answer
    last: bool


class Published(NamedTuple):
    """A result was published and has left the process; `result` is the number of its action."""

    result: int


class Recorded(NamedTuple):
    """The ledger has written an entry, or has failed to; `entry` is the number of its action."""

    entry: int


class Warned(NamedTuple):
    """The active warnings of the shell have changed: clock, network, ledger."""

    warnings: tuple[Fault, ...]


class Tick(NamedTuple):
    """The time of the last `Wake` has come."""


Event = Request | Unsent | Arrived | FromExecutor | LinkDown | Answered | Published | Recorded | Warned | Tick | Quit


class Reply(NamedTuple):
    """The one answer to a request."""

    number: int
    payload: Payload


class Publish(NamedTuple):
    """A payload for "state", "diagnostics" or "feedback"."""

    key: Literal["state", "diagnostics", "feedback"]
    payload: Payload


class Identity(NamedTuple):
    """Identifies a program for ever: the executor's process, and the number of the program."""

    instance: int
    program: int


class OpenGoal(NamedTuple):
    """An accepted goal without a result; `goal` is its id, `wall` the time of the acceptance [UNIX s]."""

    identity: Identity
    goal: str
    wall: float
    waypoints: int


class PublishResult(NamedTuple):
    """A result. The shell publishes it, notes durably that it did, and then posts `Published` with this number.

    If an earlier planner process accepted the goal, the result is `inherited`: clients must first find this process.
    """

    number: int
    identity: Identity
    inherited: bool
    payload: Payload


class AcceptanceEntry(NamedTuple):
    """The acceptance of a goal or jog, for the ledger; `wall` is its time [UNIX s]."""

    goal: str
    wall: float
    waypoints: int


class ResultEntry(NamedTuple):
    """The result of a goal or jog, for the ledger; `wall` is its time [UNIX s]."""

    wall: float
    status: str
    code: int
    message: str
    switches: int


class Record(NamedTuple):
    """An entry for the ledger. The shell posts `Recorded` with its number when it is written, or cannot be written.

    With both `accepted` and `ended`, the goal may not be in the ledger yet.
    """

    entry: int
    identity: Identity
    accepted: AcceptanceEntry | None
    ended: ResultEntry | None


class RecordCounts(NamedTuple):
    """The executor's counts of switches, one for each actuator, for the ledger."""

    counts: tuple[int, ...]


class ToExecutor(NamedTuple):
    """A message for the executor; dropped without a connection."""

    message: Down


class Start(NamedTuple):
    """A task for a worker; answered by one or several `Answered` of this number."""

    number: int
    task: Task


class Abandon(NamedTuple):
    """A task is no longer needed: its worker ends it soon. Its last answer comes nevertheless."""

    number: int


class Hurry(NamedTuple):
    """Other requests wait for a task: its worker ends its search as soon as there is an answer."""

    number: int


class Disconnect(NamedTuple):
    """The executor is silent: close the connection, and connect again."""

    reason: str


class Wake(NamedTuple):
    """Post `Tick` at this time [s]; replaces the `Wake` before."""

    at: float


class Fail(NamedTuple):
    """The process must end with this message, because a worker does not answer; the service manager starts it again."""

    reason: str


ForClients = Reply | Publish | PublishResult
ForLedger = Record | RecordCounts
ForWorkers = Start | Abandon | Hurry
Action = ForClients | ForLedger | ForWorkers | ToExecutor | Disconnect | Wake | Notify | Log | Fail

SHUTTING_DOWN = Reason.SHUTTING_DOWN.sentence


def done(message: str) -> Payload:
    """Returns the answer to a request that was carried out."""
    return {"accepted": True, "code": codes.SUCCESSFUL, "message": message}


def refused(refusal: Refusal, goal: str | None = None) -> Payload:
    """Returns the answer to a request that was refused; `goal` is its id, if the refusal does not know it."""
    name = refusal.goal if goal is None else goal
    return {
        "accepted": False,
        "id": name,
        "code": refusal.code,
        "reason": refusal.reason.value,
        "message": str(refusal),
    }
