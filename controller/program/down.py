"""Messages from a client to the executor."""

from typing import Annotated, Literal

from msgspec import Meta

from controller.program.parts import MOST_ACTUATORS, MOST_STAGES, Message, Number, Seconds, Stages, States, Text


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
        homed: packed mask. Those of these actuators whose state is unknown are brought to that of the last stage before
            the first stage, and no others are. Empty: all are brought to their state of `start`.
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
    homed: States = b""


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
