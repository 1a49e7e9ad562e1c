"""Requests of a page, strictly decoded: JSON objects with `do` and a number `n`, which the answer repeats."""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

MOST_BYTES = 1_100_000  # a goal's file of a million bytes, and the message around it

Number = Annotated[int, Meta(ge=0, le=2**53)]
Label = Annotated[str, Meta(min_length=1, max_length=100)]


class Asked(Struct, forbid_unknown_fields=True, tag_field="do", kw_only=True):
    """A message of a page."""

    n: Number


class Stop(Asked, tag="stop"):
    """Stop the arm until a reset."""


class Cancel(Asked, tag="cancel"):
    """End the running goal."""


class Reset(Asked, tag="reset"):
    """Leave a stop or a fault."""


class Take(Asked, tag="take"):
    """Take control of the arm."""


class Release(Asked, tag="release"):
    """Release control of the arm."""


class Jog(Asked, tag="jog"):
    """Switch one actuator."""

    actuator: Label
    state: Literal["contracted", "extended"]


class Lock(Asked, tag="lock"):
    """Lock an actuator in a state, or unlock it."""

    actuator: Label
    state: Literal[0, 1] | None


class Obstacles(Asked, tag="obstacles"):
    """Replace the obstacles sent before."""

    regions: Annotated[list[Any], Meta(max_length=1000)]


class Plan(Asked, tag="plan"):
    """Plan a goal without running it."""

    goal: dict[str, Any]


class Go(Asked, tag="go"):
    """Run a goal."""

    goal: dict[str, Any]


class GoalFile(Asked, tag="file"):
    """Read a goal's file, YAML or JSON, and plan it."""

    text: Annotated[str, Meta(max_length=1_000_000)]


class Seek(Asked, tag="seek"):
    """Move a replay to a time, set its speed, pause or continue it."""

    at: float | None = None
    speed: Annotated[float, Meta(ge=0.01, le=1000)] | None = None
    paused: bool | None = None


Request = Stop | Cancel | Reset | Take | Release | Jog | Lock | Obstacles | Plan | Go | GoalFile | Seek

_decoder = msgspec.json.Decoder(Request)


class BadRequest(ValueError):
    """A message is no valid request of a page; the text says why."""


def decode(data: str) -> Request:
    """Decodes a request.

    Raises:
        BadRequest: the message is malformed.
    """
    if len(data) > MOST_BYTES:
        raise BadRequest(f"at most {MOST_BYTES} characters are accepted")
    try:
        request: Request = _decoder.decode(data)
    except (msgspec.MsgspecError, RecursionError, UnicodeError) as error:
        raise BadRequest(f"not a request of this page: {error}") from None
    return request
