"""The contract between planner and executor: motion programs and messages over one Unix socket.

The planner computes positions of the tip; the executor knows actuators only. Actuator states travel as packed bits:
actuator k is bit k % 8 of byte k // 8. Times are seconds on CLOCK_MONOTONIC, which both processes share. Identity is by
numbers: of programs, of requests, and of generations.

Each message is one packet of a SOCK_SEQPACKET socket, in MessagePack. A client sends `Hello` first and hears `Welcome`
or `Goodbye`. See `Down` for what a client may send, `Up` for what it hears.
"""

from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta

VERSION = 1
MOST_BYTES = 65_536  # of one message; what is larger is refused unread
MOST_STAGES = 1_000  # of one message; longer programs are sent in parts
MOST_PROGRAM_STAGES = 100_000
MOST_ACTUATORS = 10_000
ALIVE_EVERY, SILENT_AFTER = 0.2, 1.0  # [s] between two messages of the planner, and when it counts as hung

States = Annotated[bytes, Meta(max_length=(MOST_ACTUATORS + 7) // 8)]
Number = Annotated[int, Meta(ge=0, le=2**62)]
Index = Annotated[int, Meta(ge=-1, lt=2**31)]
Seconds = Annotated[float, Meta(ge=-1e12, le=1e12)]  # NaN and infinities fail both bounds
Text = Annotated[str, Meta(max_length=1_000)]
Mode = Literal["starting", "ready", "executing", "fault", "stopped"]


class Message(msgspec.Struct, frozen=True, tag=True, array_like=True, forbid_unknown_fields=True):
    """One packet."""


class Stage(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Actuators that switch together.

    Attributes:
        states: packed actuator states at its end.
        at: when it may begin, after the program's `begin` [s].
        mark: the planner's number for the point that this stage reaches; -1 if it reaches none.
        settled: the mark counts as settled at this time at the earliest, after the program's `begin` [s].
    """

    states: States
    at: Seconds
    mark: Index = -1
    settled: Seconds = 0.0


Stages = Annotated[tuple[Stage, ...], Meta(max_length=MOST_STAGES)]

# --- down: from a client to the executor


class Hello(Message, frozen=True, tag="hello"):
    """The first message of a client. Only one `planner` is connected at a time; an `operator` may only halt and ask."""

    version: int
    role: Literal["planner", "operator"]
    arm: Text


class Alive(Message, frozen=True, tag="alive"):
    """The planner works. It sends this, or anything else, every `ALIVE_EVERY` seconds."""


class Program(Message, frozen=True, tag="program"):
    """A motion program: replaces the running one, or is declined as a whole. The answer is `Accepted` or `Declined`.

    No stage switches a locked actuator. The executor sets its output to the state in which it is locked, in stages of
    its own before the first one, so that it stays where it is when it comes loose.

    Attributes:
        program: its number, greater than of all programs before.
        epoch: the executor's epoch when the goal came in; a program of an older epoch is declined.
        start: packed outputs from which the stages were planned; another start is declined.
        begin: its zero of time [s]; 0 means now.
        stages: the first of its stages.
        final: whether these are all; the others come as `Replacement`.
        strict: no stage may be left out or begin before the one before has settled.
        name: for sentences, e.g. "goal a1".
        context: opaque; comes back with its result, so that a restarted planner can publish it.
    """

    program: Number
    epoch: Number
    start: States
    begin: Seconds
    stages: Stages
    final: bool
    strict: bool
    name: Text
    context: Annotated[bytes, Meta(max_length=8_192)] = b""


class Replacement(Message, frozen=True, tag="replacement"):
    """New stages for a running program from stage `first` on. The answer is `Replaced`.

    It is refused if stage `first` has begun, or if the stage before it does not end in `start`.

    Attributes:
        generation: greater than of all replacements of this program before.
        first: index of the first stage that is replaced; the number of stages so far to append.
        strict: makes the program strict from now on; a strict program stays so.
    """

    program: Number
    generation: Number
    first: Number
    start: States
    stages: Stages
    final: bool
    strict: bool = False


class Setpoint(Message, frozen=True, tag="setpoint"):
    """What a followed set-point asks for, until the next one; no answer.

    Attributes:
        stream: number of the stream of set-points; greater than of all streams before.
        epoch: the executor's epoch when the stream began; one of an older epoch is not followed.
        start: packed outputs from which the stages were planned; ignored stages if others.
        stages: packed states that each stage ends in; empty: stay.
        until: when the stream has stopped unless another message comes [s].
        strict: as of a program.
        reason: a sentence for `state`.
    """

    stream: Number
    epoch: Number
    start: States
    stages: Annotated[tuple[States, ...], Meta(max_length=MOST_STAGES)]
    until: Seconds
    strict: bool
    reason: Text


class Clearance(Message, frozen=True, tag="clearance"):
    """The answer to `Question`: what the stage touches, in words; None if it is clear."""

    question: Number
    touched: Text | None


class Cancel(Message, frozen=True, tag="cancel"):
    """Hold after the stage under way. The answer is `Answer`.

    Attributes:
        request: number for the answer.
        program: cancel this program only; None: whatever runs, set-points as well, and begin a new epoch.
        reason: a sentence for the result.
    """

    request: Number
    program: Number | None
    reason: Text


class Halt(Message, frozen=True, tag="halt"):
    """Emergency stop: hold, and take nothing until `Reset`. The answer is `Answer`."""

    request: Number


class Reset(Message, frozen=True, tag="reset"):
    """Leave a fault or a stop. The answer is `Answer`."""

    request: Number


class Lock(Message, frozen=True, tag="lock"):
    """Lock an actuator in a state, or unlock it with -1; nothing moves. The answer is `Answer`."""

    request: Number
    actuator: Annotated[int, Meta(ge=0, lt=MOST_ACTUATORS)]
    state: Annotated[int, Meta(ge=-1, le=1)]


class Acknowledge(Message, frozen=True, tag="acknowledge"):
    """The result of this number was published; the executor forgets it."""

    result: Number


class Counts(Message, frozen=True, tag="counts"):
    """Switches of each actuator that the ledger knows of; the greater of ledger and journal holds."""

    counts: Annotated[tuple[Number, ...], Meta(max_length=MOST_ACTUATORS)]


Down = (
    Hello | Alive | Program | Replacement | Setpoint | Clearance | Cancel | Halt | Reset | Lock | Acknowledge | Counts
)

# --- up: from the executor to a client


class Welcome(Message, frozen=True, tag="welcome"):
    """The answer to `Hello`.

    Attributes:
        digest: SHA-256 of the arm's file, in hexadecimal; a planner with another file must not drive this executor.
        instance: random number of this run of the executor.
        counts: switches of each actuator so far.
        program: the greatest number of a program or stream so far; a planner counts on from here.
    """

    version: int
    arm: Text
    digest: Text
    instance: Number
    counts: tuple[Number, ...]
    program: Number


class Goodbye(Message, frozen=True, tag="goodbye"):
    """The client is not served, and why; the executor closes the connection."""

    reason: Text


class Answer(Message, frozen=True, tag="answer"):
    """The answer to a request."""

    request: Number
    accepted: bool
    message: Text


class Accepted(Message, frozen=True, tag="accepted"):
    """The program runs.

    Attributes:
        program: its number.
        begin: its zero of time [s].
    """

    program: Number
    begin: Seconds


class Declined(Message, frozen=True, tag="declined"):
    """The program does not run.

    Attributes:
        program: its number.
        cause: "moved" asks to plan again from the latest snapshot; others are final.
        reason: a sentence.
    """

    program: Number
    cause: Literal["moved", "epoch", "mode", "locked", "malformed"]
    reason: Text


class Replaced(Message, frozen=True, tag="replaced"):
    """Whether a replacement was taken."""

    program: Number
    generation: Number
    accepted: bool


class Begun(Message, frozen=True, tag="begun"):
    """A stage of a program was switched.

    Attributes:
        program: its number.
        stage: index.
        switches: actuators switched by the program so far.
    """

    program: Number
    stage: Number
    switches: Number


class Settled(Message, frozen=True, tag="settled"):
    """A mark of a program is settled. Marks that were left out because they were late are not reported.

    Attributes:
        program: its number.
        mark: as in its stage.
        measured: packed states.
        known: packed, 1 where the state is known.
        switches: actuators switched by the program so far.
        stages: stages taken since the mark before.
        planned: whether all stages since the mark before were taken as planned.
    """

    program: Number
    mark: Index
    measured: States
    known: States
    switches: Number
    stages: Number
    planned: bool


class Ended(Message, frozen=True, tag="ended"):
    """The one result of a program; sent again to each new planner until it is acknowledged.

    Attributes:
        result: its number, for `Acknowledge`.
        program: of the program.
        context: as in the program.
        status: "done" if its last mark has settled.
        message: a sentence on the reason.
        mark: the last mark reached, -1 if none.
        switches: actuators switched.
        measured: packed states.
        known: packed, 1 where the state is known.
    """

    result: Number
    program: Number
    context: bytes
    status: Literal["done", "canceled", "replaced", "aborted"]
    message: Text
    mark: Index
    switches: Number
    measured: States
    known: States


class Counted(Message, frozen=True, tag="counted"):
    """Switches of each actuator so far; comes before each `Ended`, and when the executor ends."""

    counts: tuple[Number, ...]


class Question(Message, frozen=True, tag="question"):
    """Asks what a stage touches, from actuator states nobody planned; the arm holds until `Clearance`."""

    question: Number
    start: States
    stage: States


class Fault(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """An active fault or warning: a stable code, its source, and a sentence."""

    code: Text
    source: Text
    message: Text


class Snapshot(Message, frozen=True, tag="snapshot"):
    """The state of the executor, 20 times a second and on each change.

    Attributes:
        at: when it was taken [s].
        mode: of the executor.
        reason: a sentence on the mode.
        epoch: a number that grows with each cancel, halt, reset, fault and boot.
        outputs: packed outputs of the boards, as last switched.
        measured: packed states from end-stops, else outputs.
        known: packed, 1 where the measured state is known; outputs count as known only if all boards are up.
        sensed: packed, 1 where there is an end-stop.
        locked: packed, 1 where the actuator is locked.
        locks: number that grows with each change of `locked`.
        moving: whether an actuator may be on its way.
        free_at: when the last stage has settled, by travel time [s].
        program: number of the running program, -1 if none.
        mark: its last mark reached, -1 if none.
        stream: number of the stream that is followed, -1 if none.
        faults: active faults and warnings.
    """

    at: Seconds
    mode: Mode
    reason: Text
    epoch: Number
    outputs: States
    measured: States
    known: States
    sensed: States
    locked: States
    locks: Number
    moving: bool
    free_at: Seconds
    program: Annotated[int, Meta(ge=-1)]
    mark: Index
    stream: Annotated[int, Meta(ge=-1)]
    faults: Annotated[tuple[Fault, ...], Meta(max_length=100)]


class Diagnostics(Message, frozen=True, tag="diagnostics"):
    """Health of loop, buses and boards, once a second.

    Attributes:
        at: when it was taken [s].
        loop: ticks, longest_period, mean_work, longest_work, overruns of the last second, and lateness.
        buses: one mapping for each bus, fields of BusStatus.
        boards: one mapping for each board, fields of BoardStatus.
        real_time: "off", "on", or what is missing, in a sentence.
        counts: switches of each actuator so far.
        waits: periods in which the arm held because a clearance was not known.
        dropped: snapshots that were dropped because the socket was full.
    """

    at: Seconds
    loop: dict[str, float]
    buses: list[dict[str, str | int | float | dict[str, float]]]
    boards: list[dict[str, str | int | float | None]]
    real_time: Text
    counts: tuple[Number, ...]
    waits: Number
    dropped: Number


Up = (
    Welcome
    | Goodbye
    | Answer
    | Accepted
    | Declined
    | Replaced
    | Begun
    | Settled
    | Counted
    | Ended
    | Question
    | Snapshot
    | Diagnostics
)

encode = msgspec.msgpack.Encoder().encode
_down: msgspec.msgpack.Decoder[Down] = msgspec.msgpack.Decoder(Down)
_up: msgspec.msgpack.Decoder[Up] = msgspec.msgpack.Decoder(Up)


class Malformed(ValueError):
    """A packet is no message of this contract; the text says why."""


def decode_down(data: bytes) -> Down:
    """Returns the message that a client sent.

    Raises:
        Malformed: it is none.
    """
    return _decoded(_down, data)


def decode_up(data: bytes) -> Up:
    """Returns the message that the executor sent.

    Raises:
        Malformed: it is none.
    """
    return _decoded(_up, data)


T = TypeVar("T")


def _decoded(decoder: msgspec.msgpack.Decoder[T], data: bytes) -> T:
    if len(data) > MOST_BYTES:
        raise Malformed(f"the message has {len(data)} bytes, at most {MOST_BYTES} are taken")
    try:
        return decoder.decode(data)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise Malformed(f"not a message of version {VERSION}: {error}") from None


def unpack(states: bytes) -> int:
    """Returns packed states as one integer: actuator k is bit k."""
    return int.from_bytes(states, "little")


def pack(bits: int, actuators: int) -> bytes:
    """Returns one integer, actuator k at bit k, as packed states of so many actuators."""
    return bits.to_bytes((actuators + 7) // 8, "little")
