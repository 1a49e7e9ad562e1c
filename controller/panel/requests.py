"""What a page may ask: strict decoding. A message is a JSON object with `do`, and `n`, which its answer has, too."""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

MOST_BYTES = 1_100_000  # a goal's file of a million bytes, and what is around it

Number = Annotated[int, Meta(ge=0, le=2**53)]
Label = Annotated[str, Meta(min_length=1, max_length=100)]


class Asked(Struct, forbid_unknown_fields=True, tag_field="do", kw_only=True):
    """A message of a page."""

    n: Number


class Stop(Asked, tag="stop"):
    """Hold, and take nothing until a reset."""


class Cancel(Asked, tag="cancel"):
    """End the running goal."""


class Reset(Asked, tag="reset"):
    """Leave a stop or a fault."""


class Take(Asked, tag="take"):
    """Take control of the arm."""


class Release(Asked, tag="release"):
    """Give control up."""


class Jog(Asked, tag="jog"):
    """Switch one actuator."""

    actuator: Label
    state: Literal["contracted", "extended"]


class Lock(Asked, tag="lock"):
    """Lock an actuator in a state, or unlock it."""

    actuator: Label
    state: Literal[0, 1] | None


class Obstacles(Asked, tag="obstacles"):
    """Keep out of these regions, in place of those sent before."""

    regions: Annotated[list[Any], Meta(max_length=1000)]


class Plan(Asked, tag="plan"):
    """What would a goal do."""

    goal: dict[str, Any]


class Go(Asked, tag="go"):
    """Run a goal."""

    goal: dict[str, Any]


class GoalFile(Asked, tag="file"):
    """Read a goal's file, YAML or JSON, and plan it."""

    text: Annotated[str, Meta(max_length=1_000_000)]


class Seek(Asked, tag="seek"):
    """Move a replay to a time, set its speed, pause it or let it go on."""

    at: float | None = None
    speed: Annotated[float, Meta(ge=0.01, le=1000)] | None = None
    paused: bool | None = None


Request = Stop | Cancel | Reset | Take | Release | Jog | Lock | Obstacles | Plan | Go | GoalFile | Seek

_decoder = msgspec.json.Decoder(Request)


class BadRequest(ValueError):
    """A message that is none of a page; the text says what is wrong."""


def decode(data: str) -> Request:
    """Returns the request in a message.

    Raises:
        BadRequest: it is malformed.
    """
    if len(data) > MOST_BYTES:
        raise BadRequest(f"at most {MOST_BYTES} characters are taken")
    try:
        request: Request = _decoder.decode(data)
    except (msgspec.MsgspecError, RecursionError, UnicodeError) as error:
        raise BadRequest(f"not a request of this page: {error}") from None
    return request
