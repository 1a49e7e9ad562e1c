"""The contract between planner and executor: motion programs and messages over one Unix socket.

The planner computes positions of the tip; the executor knows actuators only. Actuator states travel as packed bits:
actuator k is bit k % 8 of byte k // 8. Times are seconds on CLOCK_MONOTONIC, which both processes share. Programs,
requests and generations are identified by numbers.

Each message is one packet of a SOCK_SEQPACKET socket, in MessagePack. A client sends `Hello` first and receives
`Welcome` or `Goodbye`. `Down` lists the messages from clients, `Up` those from the executor.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec

from hyperbit.controller.decoding.decoding import Unreadable, decode_packed
from hyperbit.controller.program.down import (
    Acknowledge,
    Alive,
    Cancel,
    Clearance,
    Counts,
    Down,
    Hello,
    Lock,
    PlayFault,
    Program,
    ReadErrors,
    Replacement,
    Reset,
    Setpoint,
    Stop,
    Trial,
)
from hyperbit.controller.program.parts import (
    ALIVE_EVERY,
    MOST_ACTUATORS,
    MOST_BYTES,
    MOST_CHANGES,
    MOST_PROGRAM_STAGES,
    MOST_STAGES,
    MOST_TRAVELS,
    MOST_WATCH,
    TICK,
    VERSION,
    Change,
    Mode,
    Stage,
    Travel,
    pack,
    unpack,
)
from hyperbit.controller.program.up import (
    Accepted,
    Answer,
    Begun,
    BoardErrors,
    Counted,
    Declined,
    Diagnostics,
    Ended,
    Fault,
    FaultVerb,
    Goodbye,
    PlayableFaults,
    Question,
    Replaced,
    Settled,
    Snapshot,
    Up,
    Welcome,
)


class Malformed(ValueError):
    """A packet is not a message of this contract; the text says why."""


def _decoded(kind: Any, data: bytes) -> Any:
    if len(data) > MOST_BYTES:
        raise Malformed(f"the message has {len(data)} bytes, at most {MOST_BYTES} are accepted")
    try:
        return decode_packed(data, kind)
    except Unreadable as error:
        raise Malformed(f"not a message of version {VERSION}: {error}") from None


encode = msgspec.msgpack.Encoder().encode
# Decode the message of a client, and one of the executor. Both raise Malformed if the packet is not a message.
decode_down: Callable[[bytes], Down] = partial(_decoded, Down)
decode_up: Callable[[bytes], Up] = partial(_decoded, Up)
