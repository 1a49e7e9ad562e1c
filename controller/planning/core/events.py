"""Events and actions of the planner's core, as plain data."""

from typing import Any, Literal, NamedTuple

from hyperbit.controller.host.process import Log, Notify, Quit
from hyperbit.controller.messages.arm import Running, Simulation
from hyperbit.controller.messages.goals import Answer, Feedback, Result
from hyperbit.controller.messages.parts import Region
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.motion.decoding.goal import GoalMessage, Jog
from hyperbit.controller.motion.decoding.requests import DegradeMessage, FaultMessage
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.program import Down, Fault, Up

# --- contents of requests


class CancelMessage(NamedTuple):
    goal: str | None = None  # None cancels whatever runs, and bars all earlier requests
    unread: str = ""  # why the payload could not be read; then everything is canceled


class SentObstacles(NamedTuple):
    obstacles: Any  # decoded for the workers
    regions: list[Region]  # unchanged, for the description of the arm


Key = Literal["goal", "jog", "plan", "cancel", "stop", "reset", "degrade", "obstacles", "fault", "arm"]
# Keys without a content have None.
Message = GoalMessage | Jog | CancelMessage | DegradeMessage | SentObstacles | FaultMessage | None


# --- events


class Arrival(NamedTuple):  # of a request, set-point or measured tip at the gateway
    number: int  # from 1, ascending; requests may reach the core in another order: their numbers decide
    at: float  # [s, monotonic]; after a standstill its start, because the request may have waited since


class Request(NamedTuple):  # of a client; it is answered by exactly one `Reply`
    arrival: Arrival
    key: Key  # a `stop`, or `cancel` without id, went to the executor before, as request of this number
    message: Message
    wall: float  # time of arrival [UNIX s]

    @property
    def number(self) -> int:
        return self.arrival.number


class Unsent(NamedTuple):  # of a `stop` or `cancel` to the executor; comes after its `Request`
    number: int
    reason: str


class SetpointArrived(NamedTuple):  # the latest one of a sender
    payload: bytes
    arrival: Arrival
    sender: str = ""  # what the sender attaches


class TipArrived(NamedTuple):  # the latest measured tip of a sender
    payload: bytes
    arrival: Arrival
    sender: str = ""


Arrived = SetpointArrived | TipArrived


class FromExecutor(NamedTuple):  # `Welcome` is the first message of a connection
    message: Up


class LinkDown(NamedTuple):  # repeated only if the reason changes
    reason: str


class Answered(NamedTuple):
    task: int
    answer: tasks.Answer
    last: bool  # whether no other answer to the task follows


class Published(NamedTuple):
    result: int  # number of its `PublishResult`; it has left the process


class Recorded(NamedTuple):
    entry: int  # number of its `Record`, which is written, or cannot be written


class Warned(NamedTuple):
    warnings: tuple[Fault, ...]  # active ones of the shell: clock, network, ledger


class Tick(NamedTuple):  # the time of the last `Wake` has come
    pass


Event = Request | Unsent | Arrived | FromExecutor | LinkDown | Answered | Published | Recorded | Warned | Tick | Quit


# --- actions


class LiveArm(NamedTuple):  # the fields of `Description` that change
    limits: list[str]
    sent_obstacles: list[Region]
    simulated: bool
    simulation: Simulation | None
    running: Running | None


class Reply(NamedTuple):
    number: int
    answer: Answer | LiveArm


class Publish(NamedTuple):
    key: Literal["state", "diagnostics", "feedback"]
    message: State | Diagnostics | Feedback


class Identity(NamedTuple):  # identifies a program for ever
    instance: int  # the executor's process
    program: int


class PublishResult(NamedTuple):  # the shell publishes it, notes durably that it did, and then posts `Published`
    number: int
    identity: Identity
    inherited: bool  # an earlier planner process accepted the goal: clients must first find this process
    result: Result


class AcceptanceEntry(NamedTuple):
    goal: str
    wall: float  # [UNIX s]
    waypoints: int


class ResultEntry(NamedTuple):
    wall: float  # [UNIX s]
    status: str
    code: int
    message: str
    switches: int


class Record(NamedTuple):  # for the ledger; the shell posts `Recorded` when it is written, or cannot be written
    entry: int
    identity: Identity
    accepted: AcceptanceEntry | None  # with both, the goal may not be in the ledger yet
    ended: ResultEntry | None


class RecordCounts(NamedTuple):
    counts: tuple[int, ...]  # switches of each actuator


class ToExecutor(NamedTuple):  # dropped without a connection
    message: Down


class Start(NamedTuple):  # answered by one or several `Answered` of this number
    number: int
    task: tasks.Task


class Abandon(NamedTuple):  # its worker ends the task soon; the last answer still comes
    number: int


class Hurry(NamedTuple):  # other requests wait: its worker ends the search as soon as there is an answer
    number: int


class Disconnect(NamedTuple):  # the executor is silent: close the connection, and connect again
    reason: str


class Wake(NamedTuple):
    at: float  # time of the next `Tick` [s]; replaces the `Wake` before


class Fail(NamedTuple):  # a worker does not answer: the process must end; the service manager starts it again
    reason: str


ForShell = Disconnect | Wake | Notify | Log | Fail
Action = Reply | Publish | PublishResult | Record | RecordCounts | Start | Abandon | Hurry | ToExecutor | ForShell
