"""Forms of the daemon's messages. Decoding is strict: any Zenoh client may publish on the daemon's keys."""

import contextlib
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeVar

import msgspec
import zenoh
from msgspec import Meta

from hyperbit.controller.decoding.decoding import Unreadable, convert
from hyperbit.controller.messages import state as messages
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.network.client import Client, Unanswered

TIMEOUT = 10.0  # [s] for an answer of the daemon
Code = Annotated[int, Meta(ge=-(2**31), lt=2**31)]


class Answer(msgspec.Struct, frozen=True):
    """An answer to `goal`, `stop`, `reset` or `cancel`."""

    accepted: bool
    code: Code = 0  # of FollowJointTrajectory
    message: str = ""
    reason: str | None = None  # of a refusal

    def __post_init__(self) -> None:
        """Raises UnicodeEncodeError if a text has a lone surrogate, which no ROS 2 string can hold."""
        self.text.encode()

    @property
    def text(self) -> str:
        return f"{self.message} ({self.reason})" if self.reason else self.message


class PlanAnswer(Answer, frozen=True):
    waypoints: list[Pose] = []


class ArmAnswer(msgspec.Struct, frozen=True):
    """Fields that the bridge uses of an answer to `arm`."""

    travel_time: Annotated[float, Meta(ge=0, le=3600)]  # of the actuators [s]


class GoalResult(msgspec.Struct, frozen=True):
    """The end of a goal: a message on `result`, or an entry of the daemon's ledger."""

    status: str
    code: Code | None = None
    message: str = ""
    id: str = ""

    def __post_init__(self) -> None:
        (self.status + self.message).encode()


class State(messages.State, frozen=True):
    """A ROS 2 message has its stamp in 32 bits."""

    stamp: Annotated[float, Meta(ge=0, lt=2**31)] = 0.0


class SetpointCounts(msgspec.Struct, frozen=True):
    """The fields of the counts of set-points in `diagnostics` that the bridge reports."""

    refused: Annotated[int, Meta(ge=0)] = 0
    last_refusal: str | None = None

    def __post_init__(self) -> None:
        (self.last_refusal or "").encode()


class LedgerAnswer(msgspec.Struct, frozen=True):
    """An answer to `result`. `result` is None while the goal runs, and for an unknown goal; then `reason` says so."""

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
    """Sends a request to the daemon and returns its answer, of the class `form`.

    Raises Unanswered if no answer of this form came within `timeout` [s]. `sending` is entered while the request is
    sent.
    """
    try:
        return convert(client.request(key, payload, timeout, sending), form)
    except (Unreadable, zenoh.ZError) as error:
        raise Unanswered(f"the answer to {key} cannot be read: {error}") from None
