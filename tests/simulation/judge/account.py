"""The account of the executor's side: what it was asked, what it told last, and the frames that it handed out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from hyperbit.controller.program import Accepted, Program, Replacement, Setpoint, Snapshot, unpack
from tests.simulation.judge.arm import JudgedArm, merged
from tests.simulation.judge.ground import Ground

EPSILON = 1e-6  # [s], rounding errors of sums of times


@dataclass
class Commit:
    """RPDOs that were handed out together, and the SYNCs after them.

    Attributes:
        at: time of the RPDOs [s].
        before: states that the executor believed, see `Account.believed`.
        open: buses whose RPDOs were handed out, and not their SYNC yet.
        awaited: buses whose SYNC was handed out and was not heard to have left.
        mask: actuators with an output in its RPDOs.
        extends: those whose extending output is commanded on.
        contracts_to: those whose contracting output is commanded on.
        stages: states that may be commanded, as far as the RPDOs fit them; None before the first RPDO.
        homing: mask of the actuators that may be brought to `homes` before any stage.
        homes: see `homing`.
        locked: mask of the locked actuators.
        contracts: whether the arm contracts at the end of the executor.
        releases: whether the RPDOs switch nothing on, and change no state.
        given_up: whether no SYNC may follow any more.
        unread: mask of the actuators without end-stops that were switched before, and not read back at its begin.
        switched: mask of the actuators that its SYNCs have switched.
        switched_at: time of the last of these switches [s].
        switched_to: states after it.
    """

    at: float
    before: int
    open: set[str] = field(default_factory=set)
    awaited: set[str] = field(default_factory=set)
    mask: int = 0
    extends: int = 0
    contracts_to: int = 0
    stages: list[int] | None = None
    homing: int = 0
    homes: int = 0
    locked: int = 0
    contracts: bool = False
    releases: bool = True
    given_up: bool = False
    unread: int = 0
    switched: int = 0
    switched_at: float = 0.0
    switched_to: int = 0


@dataclass
class RunStage:
    """One stage of a running program, with the locked states of locked actuators."""

    states: int
    at: float
    mark: int
    settled: float


class Run:
    """An accepted program.

    Attributes:
        number: of the program.
        begin: its zero of time [s].
        strict_from: time from which it is `strict` [s]; infinity if it is not.
        stages: all stages so far.
        begun: the last stage whose commit has begun, so that it cannot be replaced.
        generation: of the last accepted replacement.
        taken: the last stage that was told as begun.
        settled: the last stage whose mark was told as settled.
        switches: actuators switched by SYNC since the acceptance.
        moved: mask of the actuators that were commanded to another state, or whose output came on.
        counted: stages that switched something since the last mark.
        planned: whether all stages since the last mark were carried out as planned.
        mark: the last mark reached; `open_mark` until it was told as settled.
        homes: mask of actuators that may be homed before the first stage.
        taken_at: time of the last `Begun` [s].
        delayed: whether its zero of time may be later, because actuators are homed before, or were a moment ago.
        begins_by: latest zero of time, if it is delayed [s].
        accepted_at: time of the acceptance [s].
        question: number of the open question; None if none is open.
        touched: whether the last answer said that the stage is not clear.
        held_at: last time when something kept the next report from coming [s].
    """

    def __init__(self, message: Program, accepted: Accepted, locked: int, locked_states: int, homing: int) -> None:
        self.number, self.begin, self.message = message.program, accepted.begin, message
        self.strict, self.final = message.strict, message.final
        self.strict_from = -math.inf if message.strict else math.inf
        self._locked, self._locked_states = locked, locked_states
        self.start = self.aligned(unpack(message.start))
        self.stages: list[RunStage] = []
        self.append(0, message.stages)
        self.taken = self.settled = -1
        self.switches = self.counted = self.moved = 0
        self.homes = homing & (unpack(message.homed) if message.homed else -1)
        self.taken_at = self.held_at = self.accepted_at = accepted.begin
        self.mark = self.begun = self.generation = -1
        self.begins_by = accepted.begin
        self.planned, self.open_mark, self.touched, self.delayed = True, False, False, False
        self.question: int | None = None

    @property
    def homed(self) -> int:
        """The states to which actuators are homed before the first stage."""
        return self.stages[-1].states if self.message.homed and self.stages else self.start

    def aligned(self, states: int) -> int:
        """Returns states with the locked actuators in their locked states."""
        return merged(self._locked, self._locked_states, states)

    def append(self, first: int, stages: tuple[object, ...]) -> None:
        """Replaces the stages from `first` on."""
        self.stages[first:] = [
            RunStage(self.aligned(unpack(s.states)), s.at, s.mark, s.settled)  # type: ignore[attr-defined]
            for s in stages
        ]

    def replace(self, message: Replacement, now: float) -> None:
        """Records a replacement that is accepted now; a stage whose commit has begun is not strict by it."""
        self.append(message.first, message.stages)
        if message.strict and not self.strict:
            self.strict_from = now
        self.strict, self.final = self.strict or message.strict, message.final

    def state(self, index: int) -> int:
        """Returns the states after a stage; those before the first one for -1."""
        return self.start if index < 0 else self.stages[index].states


@dataclass
class Stream:
    """The followed set-points: the last one, and its stages that were not begun."""

    message: Setpoint
    until: float


class Account:
    """What the judge knows of one executor.

    Attributes:
        now: time [s].
        clear_since: time since when nothing disturbs the world; infinity while something does [s].
        shown: the last snapshot of the present process.
        told: mode that a snapshot or the log told last; nobody may be connected.
        ready_at: time when the mode `ready` or `executing` was shown after others [s].
        greatest: greatest number of an accepted program or stream.
        stream: number of the followed stream and its end; None if none is followed.
        mover: the last commit that switched an actuator.
        ticked: time of the last tick [s].
        asked_states: states in which locked actuators without an end-stop are locked, by the arm's file or a request.
        homed_at: time of the last commit that may have homed actuators of unknown state [s].
        unknown: mask of the actuators with two outputs, both off since the process started or their board has, and
            with no end-stop that tells their state. Of those that are locked, the executor tells a guess as output.
    """

    def __init__(self, arm: JudgedArm, ground: Ground) -> None:
        self.arm, self.ground = arm, ground
        self.now = 0.0
        self.clear_since = math.inf
        self.instance = 0
        self.begin()

    def begin(self) -> None:
        """Forgets the last process."""
        self.shown: Snapshot | None = None
        self.told = "starting"
        self.ready_at = math.inf
        self.homed_at = -math.inf
        self.greatest = self.program_number = self.stream_number = 0
        self.run: Run | None = None
        self.stream: Stream | None = None
        self.commit: Commit | None = None
        self.mover: Commit | None = None
        self.homed_at = -math.inf
        self.ticked = self.now
        self.quitting = False
        self.locked, self.locked_states = self.arm.declared
        self.locks_changed_at = self.now
        self.asked_states = self.locked_states
        self.unknown = self.arm.paired
        self.knows_unknown = False  # whether `unknown` is exact, because the world was clear at the last boot

    @property
    def clear(self) -> bool:
        """Whether nothing disturbs the world, and nothing has since the arm was ready."""
        return self.now >= self.clear_since

    @property
    def mode(self) -> str:
        """The mode that was shown last."""
        return "starting" if self.shown is None else self.shown.mode

    @property
    def adopted_until(self) -> float:
        """Time until which all actuators count as travelling or resting after a boot [s]."""
        return self.ready_at + max(map(max, self.arm.travel)) + self.arm.rest

    @property
    def committing(self) -> bool:
        """Whether frames of a commit may be under way; one that is given up tells nobody so."""
        commit, longest = self.commit, self.arm.timing.heartbeat_timeout / 2 + 0.02
        return commit is not None and bool(commit.open or commit.awaited) and self.now < commit.at + longest

    @property
    def switching(self) -> bool:
        """Whether boards have switched, and the executor has not heard of it."""
        return self.committing and self.commit is self.mover

    @property
    def believed(self) -> int:
        """The driven states; a guess of those that nobody can know, which the executor tells as outputs."""
        states = self.ground.states
        unknown = self.unknown & (self.homing | self.locked)
        return states if self.shown is None else merged(unknown, unpack(self.shown.outputs), states)

    @property
    def homing(self) -> int:
        """Mask of the actuators of unknown state."""
        return 0 if self.shown is None else unpack(self.shown.homing)
