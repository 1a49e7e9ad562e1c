"""Parts of messages in both directions: bounds, packed actuator states, stages."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

VERSION = 10
MOST_BYTES = 65_536  # of one message; larger ones are refused unread
MOST_STAGES = 1_000  # of one message; longer programs are sent in parts
MOST_PROGRAM_STAGES = 100_000
MOST_ACTUATORS = 10_000
MOST_TRAVELS = 100  # reported travels of one program
MOST_CHANGES = 1_000  # reported changes of inputs of one trial
MOST_WATCH = 60.0  # [s], longest time for which a trial watches the inputs
TICK = 0.01  # [s] of the executor's loop
ALIVE_EVERY = 0.2  # [s] between two messages of the planner

States = Annotated[bytes, Meta(max_length=(MOST_ACTUATORS + 7) // 8)]
Number = Annotated[int, Meta(ge=0, le=2**62)]
Index = Annotated[int, Meta(ge=-1, lt=2**31)]
Seconds = Annotated[float, Meta(ge=-1e12, le=1e12)]  # NaN and infinities fail both bounds
Text = Annotated[str, Meta(max_length=1_000)]
Mode = Literal["starting", "ready", "executing", "fault", "stopped"]


class Message(msgspec.Struct, frozen=True, tag=True, array_like=True, forbid_unknown_fields=True):
    pass


class Stage(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Actuators that switch together. Times count from the program's `begin`."""

    states: States  # packed actuator states at its end
    at: Seconds  # earliest begin [s]
    mark: Index = -1  # the planner's number for the point that this stage reaches; -1: none
    settled: Seconds = 0.0  # earliest time at which the mark counts as settled [s]


class Travel(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A measured travel of an actuator to one of its ends."""

    actuator: Annotated[int, Meta(ge=0, lt=MOST_ACTUATORS)]  # index
    state: Annotated[int, Meta(ge=0, le=1)]  # of the end, 0 contracted or 1 extended
    seconds: Seconds  # from the SYNC that switched it to its end-stop's frame


class Change(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """An input that changed after the switch of a trial."""

    line: Annotated[int, Meta(ge=0)]  # index in the input lines of the wiring
    level: Annotated[int, Meta(ge=0, le=1)]
    seconds: Seconds  # since the SYNC of the switch


Stages = Annotated[tuple[Stage, ...], Meta(max_length=MOST_STAGES)]


def unpack(states: bytes) -> int:
    """Returns packed states as one integer: actuator k is bit k."""
    return int.from_bytes(states, "little")


def pack(bits: int, actuators: int) -> bytes:
    """Returns one integer, actuator k at bit k, as packed states of `actuators` actuators."""
    return bits.to_bytes((actuators + 7) // 8, "little")
