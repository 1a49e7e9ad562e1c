"""Messages from a client to the executor."""

from typing import Annotated, Literal

from msgspec import Meta

from hyperbit.controller.program.parts import (
    MOST_ACTUATORS,
    MOST_STAGES,
    MOST_WATCH,
    Message,
    Number,
    Seconds,
    Stages,
    States,
    Text,
)


class Hello(Message, frozen=True, tag="hello"):
    """The first message of a client.

    Only one `planner` or `commissioner` can be connected. While a commissioner is, no end-stop is believed, and the arm
    moves by `Trial` only. An `operator` can only stop the arm, and read errors of boards.
    """

    version: int
    role: Literal["planner", "operator", "commissioner"]
    arm: Text


class Alive(Message, frozen=True, tag="alive"):
    """The planner is alive. It sends this, or another message, every `ALIVE_EVERY` seconds."""


class Program(Message, frozen=True, tag="program"):
    """A motion program. It replaces the running one, or is declined as a whole. Answered by `Accepted` or `Declined`.

    No stage switches a locked actuator. Before the first stage the executor sets the output of each locked actuator to
    its locked state, in stages of its own. The actuator then stays in place if it comes loose.

    A program that is not `final` gets further stages by `Replacement`. While it waits for them, the arm holds. After 10
    s without further stages the program is aborted; replacements without stages do not count.

    Before the first stage, actuators of unknown state in `homed` are switched to their state of the last stage; no
    others are homed. If `homed` is empty, all are homed to their state of `start`. Nothing is homed while a program
    that is not `final` has no stages.
    """

    program: Number  # greater than the numbers of all earlier programs
    epoch: Number  # the executor's when the goal arrived; a program of an older epoch is declined
    start: States  # packed outputs from which the stages were planned; must match the present ones
    begin: Seconds  # zero of its time [s]; 0: now
    stages: Stages
    final: bool
    strict: bool  # no stage is skipped, or begins before the previous one has settled
    name: Text  # for sentences, e.g. "goal a1"
    # opaque; comes back with the result, so that a restarted planner can publish it
    context: Annotated[bytes, Meta(max_length=8_192)] = b""
    homed: States = b""  # packed mask
    until: Seconds = 1e12  # later it is declined, because its client no longer waits [s]


class Trial(Message, frozen=True, tag="trial"):
    """Command one actuator to a state, and watch all inputs. It runs as a program does, and never beside another one.

    No other output is switched: nothing else is homed, and locked actuators stay as they are. Its `Ended` has the
    inputs and their changes.
    """

    program: Number  # as that of a `Program`
    epoch: Number
    actuator: Annotated[int, Meta(ge=0, lt=MOST_ACTUATORS)]
    state: Annotated[int, Meta(ge=0, le=1)]
    watch: Annotated[float, Meta(ge=0, le=MOST_WATCH)]  # for which the inputs are watched at least [s]
    until: Seconds  # later it is declined, because nobody waits for it any longer [s]


class Replacement(Message, frozen=True, tag="replacement"):
    """New stages for a running program from stage `first` on. Answered by `Replaced`.

    It is refused if stage `first` has begun, or if the stage before does not end in `start`. An accepted replacement
    makes the answer to an earlier `Question` invalid; the executor asks again.

    A replacement without stages that is not `final` parks the program: the arm holds at stage `first` - 1, and later
    replacements append from `first` on. A program can be parked as long as its result has not been sent, also after its
    last stage has begun.
    """

    program: Number
    generation: Number  # greater than that of all earlier replacements of this program
    first: Number  # index of the first replaced stage; the number of stages so far appends
    start: States
    stages: Stages
    final: bool
    strict: bool = False  # from now on; a strict program stays strict


class Setpoint(Message, frozen=True, tag="setpoint"):
    """The stages for a followed set-point, valid until the next message; no answer."""

    stream: Number  # greater than the numbers of all earlier streams
    epoch: Number  # the executor's when the stream began; a stream of an older epoch is not followed
    start: States  # packed outputs from which the stages were planned; if they differ, the stages are ignored
    stages: Annotated[tuple[States, ...], Meta(max_length=MOST_STAGES)]  # packed states after each stage; empty: stay
    until: Seconds  # the stream ends then unless another message comes [s]
    strict: bool  # as for a program
    reason: Text  # a sentence for `state`


class Clearance(Message, frozen=True, tag="clearance"):
    """The answer to `Question`: what the stage collides with, in words; None if it is clear.

    The executor uses an answer for one attempt to begin the stage. It ignores answers to earlier questions.
    """

    question: Number
    touched: Text | None


class Cancel(Message, frozen=True, tag="cancel"):
    """Hold after the present stage. Answered by `Answer`."""

    request: Number  # number for the answer, in each request; it need not be unique
    program: Number | None  # cancel this program only; None: cancel any program or stream, and begin a new epoch
    reason: Text  # a sentence for the result


class Stop(Message, frozen=True, tag="stop"):
    """Stop: hold, and accept no motion until `Reset`. Answered by `Answer` when nothing switches any more."""

    request: Number


class Reset(Message, frozen=True, tag="reset"):
    """Leave a fault or a stop. Answered by `Answer`; refused if a stop, cancel or fault came after it."""

    request: Number
    epoch: Number  # the executor's when the request arrived


class Lock(Message, frozen=True, tag="lock"):
    """Lock an actuator in a state, or unlock it with -1; nothing moves. Answered by `Answer`."""

    request: Number
    actuator: Annotated[int, Meta(ge=0, lt=MOST_ACTUATORS)]
    state: Annotated[int, Meta(ge=-1, le=1)]


class ReadErrors(Message, frozen=True, tag="read-errors"):
    """Read the errors of a board, in any mode. Answered by `BoardErrors`, after a boot that is under way."""

    request: Number
    board: Text  # e.g. "can0/5"


class PlayFault(Message, frozen=True, tag="play-fault"):
    """Play a fault in simulated boards, such as "silence can0/5". Answered by `Answer`; refused if boards are real."""

    request: Number
    fault: Text


class Acknowledge(Message, frozen=True, tag="acknowledge"):
    """The result of this number was published; the executor may delete it."""

    result: Number


class Counts(Message, frozen=True, tag="counts"):
    """Switches of each actuator in the ledger; the greater of ledger and journal is valid."""

    counts: Annotated[tuple[Number, ...], Meta(max_length=MOST_ACTUATORS)]


Down = (
    Hello
    | Alive
    | Program
    | Trial
    | Replacement
    | Setpoint
    | Clearance
    | Cancel
    | Stop
    | Reset
    | Lock
    | ReadErrors
    | PlayFault
    | Acknowledge
    | Counts
)
