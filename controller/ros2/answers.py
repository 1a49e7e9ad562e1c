"""What the daemon sends, strictly decoded: whoever is on its keys may send anything."""

import contextlib
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeVar

import msgspec
import zenoh
from msgspec import Meta

from hyperbit.controller.network.client import Client, Unanswered

TIMEOUT = 10.0  # [s] for an answer of the daemon
Code = Annotated[int, Meta(ge=-(2**31), lt=2**31)]
Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
Position = Annotated[list[Number], Meta(min_length=2, max_length=3)]
Orientation = Number | Annotated[list[Number], Meta(min_length=4, max_length=4)]
ActuatorState = Annotated[int, Meta(ge=0, le=1)]


class Answer(msgspec.Struct, frozen=True):
    """An answer to `goal`, `stop`, `reset` or `cancel`.

    Attributes:
        accepted: whether the request is carried out.
        code: of FollowJointTrajectory.
        message: a sentence.
        reason: of a refusal.
    """

    accepted: bool
    code: Code = 0
    message: str = ""
    reason: str | None = None

    def __post_init__(self) -> None:
        """Checks the texts; they may come from JSON with half characters, which no message of ROS 2 can hold."""
        self.text.encode()

    @property
    def text(self) -> str:
        """The sentence, with the reason of a refusal."""
        return f"{self.message} ({self.reason})" if self.reason else self.message


class TipPose(msgspec.Struct, frozen=True):
    """A pose of the tip, in a state or at a waypoint of a plan."""

    position: Position
    orientation: Orientation | None = None


class PlanAnswer(Answer, frozen=True):
    """An answer to `plan`."""

    waypoints: list[TipPose] = []


class ArmAnswer(msgspec.Struct, frozen=True):
    """What of an answer to `arm` is needed here: `travel_time` of the actuators [s]."""

    travel_time: Annotated[float, Meta(ge=0, le=3600)]


class GoalResult(msgspec.Struct, frozen=True):
    """How a goal ended: a message on `result`, or what the daemon's ledger has."""

    status: str
    code: Code | None = None
    message: str = ""
    id: str = ""

    def __post_init__(self) -> None:
        """Checks the texts as those of an answer."""
        (self.status + self.message).encode()


class Fault(msgspec.Struct, frozen=True):
    """A fault in a state."""

    code: str
    source: str
    message: str


class Target(msgspec.Struct, frozen=True):
    """Where the arm is to be; a configuration has no position."""

    position: Position | None = None
    orientation: Orientation | None = None


class State(msgspec.Struct, frozen=True):
    """What of a `state` is published; a message that is none is not."""

    stamp: Annotated[float, Meta(ge=0, lt=2**31)]
    mode: str
    reason: str
    faults: Annotated[list[Fault], Meta(max_length=10_000)]
    measured: list[ActuatorState | None] | None = None
    commanded: list[ActuatorState | None] | None = None
    tip: TipPose | None = None
    target: Target | None = None
    goal: str | None = None


class SetpointCounts(msgspec.Struct, frozen=True):
    """What of the counts of set-points in `diagnostics` is told."""

    refused: Annotated[int, Meta(ge=0)] = 0
    last_refusal: str | None = None

    def __post_init__(self) -> None:
        """Checks the text as those of an answer."""
        (self.last_refusal or "").encode()


class LedgerAnswer(msgspec.Struct, frozen=True):
    """An answer to `result`: the result is None while the goal runs, and if it is unknown, as `reason` tells."""

    result: GoalResult | None = None
    reason: str | None = None


Sending = Callable[[], contextlib.AbstractContextManager[None]]
Form = TypeVar("Form", Answer, PlanAnswer, ArmAnswer, LedgerAnswer)


def request(
    client: Client,
    form: type[Form],
    key: str,
    payload: Mapping[str, Any] | None = None,
    sending: Sending = contextlib.nullcontext,
    timeout: float = TIMEOUT,
) -> Form:
    """Sends a request to the daemon and returns its answer.

    Args:
        client: of the daemon.
        form: of the answer.
        key: such as goal.
        payload: of the request.
        sending: entered while the request is sent.
        timeout: longest time to wait [s].

    Raises:
        Unanswered: no answer came in time, or it has another form.
    """
    try:
        return msgspec.convert(client.request(key, payload, timeout, sending), form)
    except (msgspec.ValidationError, zenoh.ZError, ValueError, RecursionError) as error:
        raise Unanswered(f"the answer to {key} cannot be read: {error}") from None
