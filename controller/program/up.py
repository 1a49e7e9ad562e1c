"""Messages from the executor to a client."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from hyperbit.controller.messages.state import Board, Bus, LoopTimes
from hyperbit.controller.program.parts import (
    MOST_ACTUATORS,
    MOST_CHANGES,
    MOST_TRAVELS,
    Change,
    Index,
    Message,
    Mode,
    Number,
    Seconds,
    States,
    Text,
    Travel,
)
from hyperbit.controller.refusals.refusal import Refused


class FaultVerb(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A verb of `PlayFault`."""

    verb: Text  # the first word
    target: Literal["actuator", "board", "bus", "interlock"]  # kind of the second word
    argument: Text  # name of the third word; in brackets if it is optional, "" if there is none
    text: Text  # what the verb does


class PlayableFaults(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Simulated boards: their playable faults, and the names that these faults need."""

    faults: tuple[FaultVerb, ...]
    boards: tuple[Text, ...]
    buses: tuple[Text, ...]
    interlocks: tuple[Text, ...]


class Welcome(Message, frozen=True, tag="welcome"):
    """The answer to `Hello`."""

    arm: Text
    digest: Text  # SHA-256 of the arm's file, in hexadecimal; a planner needs the same file
    instance: Number  # random number of this executor process
    counts: tuple[Number, ...]  # switches of each actuator so far
    program: Number  # the greatest number of a program or stream so far; a planner continues from here
    simulation: PlayableFaults | None = None  # None: the executor commands boards on CAN buses


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
        return self.refused is None


class BoardErrors(Message, frozen=True, tag="board-errors"):
    """What a board tells of its errors; or why it could not be asked, as a sentence."""

    request: Number
    why: Text = ""
    register: Annotated[int, Meta(ge=0, le=0xFF)] = 0  # 1001h
    # entries of 1003h, the newest first; None: the board has no 1003h
    history: Annotated[tuple[Number, ...], Meta(max_length=254)] | None = None
    complete: bool = True  # whether the history has all errors since the last reset


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

    A mark that was skipped as late is not reported; nor is one that had not settled when the next stage began.
    """

    program: Number
    mark: Index
    measured: States
    known: States  # 1 where the measured state is known
    switches: Number  # actuators switched by the program so far
    stages: Number  # carried out since the previous mark
    planned: bool  # all planned stages since the previous mark were carried out


class Ended(Message, frozen=True, tag="ended"):
    """The one result of a program; it is sent to each new planner until it is acknowledged."""

    result: Number  # number for `Acknowledge`
    program: Number
    context: bytes  # of the program
    status: Literal["done", "canceled", "replaced", "aborted"]  # "done" if the last mark has settled
    message: Text  # a sentence on the reason
    mark: Index  # the last one reached, -1: none
    switches: Number
    measured: States
    known: States  # 1 where the measured state is known
    travels: Annotated[tuple[Travel, ...], Meta(max_length=MOST_TRAVELS)] = ()  # the first MOST_TRAVELS
    verified: bool = True  # end-stops or read-back outputs have confirmed each switch, unless the arm's file forgoes it
    # of a trial: levels of the input lines before its switch, packed, and their first MOST_CHANGES changes since
    inputs: Annotated[bytes, Meta(max_length=MOST_ACTUATORS)] = b""
    changes: Annotated[tuple[Change, ...], Meta(max_length=MOST_CHANGES)] = ()


class Counted(Message, frozen=True, tag="counted"):
    """Switches of each actuator so far; sent before each `Ended`, and when the executor ends."""

    counts: tuple[Number, ...]


class Question(Message, frozen=True, tag="question"):
    """Asks with what a stage collides from states for which it was not planned; the arm holds until `Clearance`."""

    question: Number
    start: States
    stage: States


class Fault(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """An active fault or warning: a stable code, its source, and a sentence."""

    code: Text
    source: Text
    message: Text


class Snapshot(Message, frozen=True, tag="snapshot"):
    """The state of the executor, 20 times a second and on each change. `States` are packed."""

    at: Seconds
    mode: Mode
    reason: Text  # a sentence on the mode
    epoch: Number  # grows with each cancel of all, stop, reset, fault, boot, change of locks, and loss of the planner
    outputs: States  # of the boards, as last switched
    measured: States  # states from end-stops, otherwise from outputs
    known: States  # 1 where the measured state is known; outputs count as known only if all boards are up
    sensed: States  # 1 where there is an end-stop
    locked: States  # 1 where the actuator is locked
    moving: bool  # an actuator may be travelling; for travels that began before the end of a boot see `free_at`
    free_at: Seconds  # time at which the last stage has settled, by travel time [s]
    program: Annotated[int, Meta(ge=-1)]  # number of the running one, -1: none
    stream: Annotated[int, Meta(ge=-1)]  # number of the followed one, -1: none
    faults: Annotated[tuple[Fault, ...], Meta(max_length=100)]  # active faults and warnings
    # 1 where the state is unknown until the next program homes the actuator; `outputs` has a guess
    homing: States = b""
    unread: States = b""  # 1 where neither an end-stop nor the read-back output has confirmed the last switch


class Diagnostics(Message, frozen=True, tag="diagnostics"):
    """Health of loop, buses and boards, once a second."""

    at: Seconds
    loop: LoopTimes
    buses: list[Bus]
    boards: list[Board]
    real_time: Text  # "off", "on", or a sentence on what is missing
    counts: tuple[Number, ...]  # switches of each actuator so far
    waits: Number  # periods in which the arm held because a clearance was not known
    dropped: Number  # snapshots, because the socket was full


Up = (
    Welcome
    | Goodbye
    | Answer
    | BoardErrors
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
