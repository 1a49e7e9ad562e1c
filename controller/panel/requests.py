"""Requests of a page, strictly decoded: JSON objects with `do` and a number `n`, which the answer repeats."""

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from hyperbit.controller.decoding.decoding import Unreadable, decode

MOST_BYTES = 1_100_000  # a goal's file of a million bytes, and the message around it

Number = Annotated[int, Meta(ge=0, le=2**53)]
Label = Annotated[str, Meta(min_length=1, max_length=100)]


class NumberedRequest(Struct, forbid_unknown_fields=True, tag_field="do", kw_only=True):
    """A message of a page: its number, and the number of the latest heartbeat that the page has received."""

    n: Number
    heartbeat: Number | None = None


class StopRequest(NumberedRequest, tag="stop"):
    """Stop the arm until a reset."""


class CancelRequest(NumberedRequest, tag="cancel"):
    """End the running goal."""


class ResetRequest(NumberedRequest, tag="reset"):
    """Leave a stop or a fault."""


class TakeControlRequest(NumberedRequest, tag="take"):
    pass


class ReleaseControlRequest(NumberedRequest, tag="release"):
    pass


class JogRequest(NumberedRequest, tag="jog"):
    actuator: Label
    state: Literal["contracted", "extended"]


class LockRequest(NumberedRequest, tag="lock"):
    """Lock an actuator in a state; None: unlock it."""

    actuator: Label
    state: Literal[0, 1] | None


class ObstaclesRequest(NumberedRequest, tag="obstacles"):
    regions: Annotated[list[Any], Meta(max_length=1000)]


class FaultRequest(NumberedRequest, tag="fault"):
    """Play a fault in the boards of a simulated arm."""

    fault: Annotated[str, Meta(min_length=1, max_length=200)]


class PoseRequest(NumberedRequest, tag="pose"):
    """Save a goal as a named pose, or remove a pose."""

    save: Annotated[str, Meta(max_length=100)] | None = None
    goal: dict[str, Any] | None = None
    remove: Annotated[str, Meta(max_length=100)] | None = None


class PlanRequest(NumberedRequest, tag="plan"):
    goal: dict[str, Any]


class GoalRequest(NumberedRequest, tag="go"):
    goal: dict[str, Any]


class GoalFileRequest(NumberedRequest, tag="file"):
    """Read a goal's file, CSV, JSON or YAML by the ending of its name, and plan it."""

    text: Annotated[str, Meta(max_length=1_000_000)]
    name: Annotated[str, Meta(max_length=255)] = "file"


class AgainRequest(NumberedRequest, tag="again"):
    """Plan a goal that was sent before, by the id of that goal."""

    id: Label


class AnswerRequest(NumberedRequest, tag="answer"):
    """Answer the question of a commission, by its number."""

    question: Number
    answer: Annotated[str, Meta(max_length=100)]


class SeekRequest(NumberedRequest, tag="seek"):
    """Move a replay to a time, set its speed, pause or continue it."""

    at: float | None = None
    speed: Annotated[float, Meta(ge=0.01, le=1000)] | None = None
    paused: bool | None = None


UrgentRequest = StopRequest | CancelRequest
FreeRequest = (
    UrgentRequest
    | TakeControlRequest
    | ReleaseControlRequest
    | PlanRequest
    | GoalFileRequest
    | AgainRequest
    | SeekRequest
)
ControlRequest = (  # need control, and the number of a recent heartbeat, because each can lead to motion
    ResetRequest
    | JogRequest
    | LockRequest
    | ObstaclesRequest
    | FaultRequest
    | PoseRequest
    | GoalRequest
    | AnswerRequest
)
PageRequest = FreeRequest | ControlRequest


class BadRequest(ValueError):
    """A message is no valid request of a page; the text says why."""


def decode_request(data: str) -> PageRequest:
    """Decodes a request. Raises BadRequest if the message is malformed."""
    if len(data) > MOST_BYTES:
        raise BadRequest(f"at most {MOST_BYTES} characters are accepted")
    try:
        request: PageRequest = decode(data, PageRequest)
    except Unreadable as error:
        raise BadRequest(f"not a request of this page: {error}") from None
    return request
