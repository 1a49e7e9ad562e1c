"""Messages from the executor to a client."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from hyperbit.controller.program.parts import MOST_TRAVELS, Index, Message, Mode, Number, Seconds, States, Text, Travel
from hyperbit.controller.refusals.refusal import Refused


class FaultVerb(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A verb of `PlayFault`.

    Attributes:
        verb: the first word.
        target: what the second word names.
        argument: name of the third word; in brackets if it may be left out, "" if there is none.
        text: what the verb does.
    """

    verb: Text
    target: Literal["actuator", "board", "bus", "interlock"]
    argument: Text
    text: Text


class PlayableFaults(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Simulated boards: the faults that can be played in them, and the names that these faults need."""

    faults: tuple[FaultVerb, ...]
    boards: tuple[Text, ...]
    buses: tuple[Text, ...]
    interlocks: tuple[Text, ...]


class Welcome(Message, frozen=True, tag="welcome"):
    """The answer to `Hello`.

    Attributes:
        digest: SHA-256 of the arm's file, in hexadecimal; a planner with another file must not use this executor.
        instance: random number of this executor process.
        counts: switches of each actuator so far.
        program: the greatest number of a program or stream so far; a planner continues from here.
        simulation: the simulated boards of this process; None: the executor commands boards on CAN buses.
    """

    version: int
    arm: Text
    digest: Text
    instance: Number
    counts: tuple[Number, ...]
    program: Number
    simulation: PlayableFaults | None = None


class Goodbye(Message, frozen=True, tag="goodbye"):
    """The executor does not serve the client, and closes the connection."""

    reason: Text


class Answer(Message, frozen=True, tag="answer"):
    """The answer to a request: what is done, or why it is refused, as a sentence; and a refusal as data."""

    request: Number
    message: Text
    refused: Refused | None = None

    @property
    def accepted(self) -> bool:
        """Whether the request is carried out."""
        return self.refused is None


class Accepted(Message, frozen=True, tag="accepted"):
    """The program runs; `begin` is its zero of time [s]."""

    program: Number
    begin: Seconds


class Declined(Message, frozen=True, tag="declined"):
    """The program does not run. If the arm has moved, the planner must plan again from the latest snapshot.

    Other refusals are final.
    """

    program: Number
    refused: Refused


class Replaced(Message, frozen=True, tag="replaced"):
    """Whether a replacement was accepted."""

    program: Number
    generation: Number
    accepted: bool


class Begun(Message, frozen=True, tag="begun"):
    """A stage of a program was switched; `switches`: actuators switched by the program so far."""

    program: Number
    stage: Number
    switches: Number


class Settled(Message, frozen=True, tag="settled"):
    """A mark of a program has settled; each is reported once.

    Marks are not reported if they were skipped because they were late, or if the next stage began before they settled.

    Attributes:
        measured, known: packed states, and 1 where the state is known.
        switches: actuators switched by the program so far.
        stages: stages carried out since the mark before.
        planned: whether all planned stages since the mark before were carried out.
    """

    program: Number
    mark: Index
    measured: States
    known: States
    switches: Number
    stages: Number
    planned: bool


class Ended(Message, frozen=True, tag="ended"):
    """The one result of a program; it is sent to each new planner until it is acknowledged.

    Attributes:
        result: its number, for `Acknowledge`.
        context: of the program.
        status: "done" if the last mark has settled.
        message: a sentence on the reason.
        mark: the last mark reached, -1 if none.
        measured, known: packed states, and 1 where the state is known.
        travels: the first MOST_TRAVELS measured travels.
        verified: whether end-stops or outputs, read back, have told of each switch; else the arm's file forgoes it.
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
    travels: Annotated[tuple[Travel, ...], Meta(max_length=MOST_TRAVELS)] = ()
    verified: bool = True


class Counted(Message, frozen=True, tag="counted"):
    """Switches of each actuator so far; sent before each `Ended`, and when the executor ends."""

    counts: tuple[Number, ...]


class Question(Message, frozen=True, tag="question"):
    """Asks what a stage collides with, from states for which it was not planned; the arm holds until `Clearance`."""

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
        at: its time [s].
        reason: a sentence on the mode.
        epoch: a number that grows with each cancel, stop, reset, fault, boot, change of locks, and loss of the planner.
            A cancel of one program begins no epoch.
        outputs: packed outputs of the boards, as last switched.
        measured: packed states from end-stops, otherwise from outputs.
        known: packed, 1 where the measured state is known; outputs count as known only if all boards are up.
        sensed: packed, 1 where there is an end-stop.
        locked: packed, 1 where the actuator is locked.
        locks: number that grows with each change of `locked`.
        moving: whether an actuator may be travelling. Of travels that began before the end of a boot, `free_at` tells.
        free_at: time at which the last stage has settled, by travel time [s].
        program: number of the running program, -1 if none.
        mark: its last mark reached, -1 if none.
        stream: number of the followed stream, -1 if none.
        faults: active faults and warnings.
        homing: packed, 1 where the state is unknown until the next program homes the actuator; `outputs` has a guess.
        unread: packed, 1 where the actuator was switched, and neither an end-stop nor its output, read back, has told.
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
    homing: States = b""
    unread: States = b""


class Diagnostics(Message, frozen=True, tag="diagnostics"):
    """Health of loop, buses and boards, once a second.

    Attributes:
        at: its time [s].
        loop: ticks, longest_period, mean_work, longest_work, overruns of the last second, and lateness.
        buses: one mapping for each bus, fields of BusStatus.
        boards: one mapping for each board, fields of BoardStatus.
        real_time: "off", "on", or a sentence on what is missing.
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
