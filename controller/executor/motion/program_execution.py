"""Progress of one motion program: which stage is due, and which mark has settled. `motion` does the switching."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.program import MOST_PROGRAM_STAGES, Program, Replacement, Stage, Travel, unpack

EPSILON = 1e-9  # [s]
MOST_AHEAD = 1_000  # stages that may be skipped at once
FED_WITHIN = 10.0  # [s]; a program that waits for its next stages for longer is aborted
STARVED = f"the planner sent no further stages for {FED_WITHIN:g} s"


class End(NamedTuple):
    """How a program or stream has ended by itself.

    Attributes:
        status: of the result.
        message: of the result.
        reason: a sentence for the mode.
    """

    status: str
    message: str
    reason: str


class StageMisfit(ValueError):
    """Stages do not fit the arm or the running program; the text says why.

    Attributes:
        locked: whether a locked actuator is the reason.
    """

    def __init__(self, reason: str, locked: bool = False) -> None:
        """Takes the reason, and whether a locked actuator is the reason."""
        super().__init__(reason)
        self.locked = locked


class ProgramExecution:
    """The progress of a running program.

    Attributes:
        program: the program as it was sent.
        begin: zero of the program's time [s].
        taken: index of the last stage that the outputs have reached; -1 before the first.
        mark: the last mark reached; -1 before the first.
        switches: number of switches so far.
        stages: number of stages that switched something since the previous mark.
        planned: whether all stages since the previous mark were taken as planned.
        travels: travel times measured so far.
        verified: whether something tells that each switched actuator has followed.
        strict: no stage is skipped, and none begins before the previous one has settled.
        final: no more stages will come.

    Args:
        program: a program whose stages were checked.
        begin: zero of the program's time [s].
        locked: the locked actuators; they have their locked states in every stage.
    """

    def __init__(self, program: Program, begin: float, locked: LockedActuators) -> None:
        self.program, self.begin = program, begin
        self.strict, self.final = program.strict, program.final
        self.taken = self.mark = -1
        self.switches = self.stages = 0
        self.planned = True
        self.travels: list[Travel] = []
        self.verified = True
        self._generation = -1
        self._begun = -1  # the last stage whose commit was begun
        self._stages = list(program.stages)
        self._locked = locked
        self._states = [locked.aligned(unpack(stage.states)) for stage in program.stages]
        self._at = [stage.at for stage in program.stages]
        self._start = locked.aligned(unpack(program.start))
        self._settles: float | None = None  # when the mark reached settles [s]
        self._waits_since: float | None = None  # for its next stages, after all others [s, awake time]

    def state(self, index: int) -> int:
        """Returns the states at the end of a stage; those from which the program was planned for stage -1."""
        return self._start if index < 0 else self._states[index]

    @property
    def homed(self) -> tuple[int, int]:
        """Mask of the actuators to home before the first stage if their state is unknown, and the states to home to.

        Without stages nothing is homed: the last stage has the states to home to.
        """
        if not self._states and not self.final:
            return 0, self._start
        if self.program.homed:
            return unpack(self.program.homed), self._states[-1] if self._states else self._start
        return -1, self._start

    def delay(self, now: float) -> None:
        """Moves the zero of time to now if the first stage was due before homing ended."""
        if self.taken < 0:
            self.begin = max(self.begin, now)

    def due(self, now: float, outputs: int, most: int) -> int | None:
        """Returns the index of the stage to switch to now, or None. Overdue stages are skipped, unless `strict`.

        The latest due stage within `most` switches is returned, else the next stage.

        Args:
            now: [s].
            outputs: states that the outputs command.
            most: actuators that may switch at once.
        """
        following = self.taken + 1
        latest = bisect_right(self._at, now - self.begin + EPSILON, lo=following) - 1
        if latest < following:
            return None
        if not self.strict:
            for k in range(min(latest, following + MOST_AHEAD), following, -1):
                if (outputs ^ self._states[k]).bit_count() <= most:
                    return k
        return following

    def record_begun(self, index: int) -> None:
        """Records that the commit of a stage has begun: the stage can no longer be replaced."""
        self._begun = max(self._begun, index)

    def record_reached(self, index: int, before: int, switched: bool, settled: float) -> None:
        """Records that the outputs have reached a stage.

        Args:
            index: of the stage.
            before: states before the stage.
            switched: whether anything was switched.
            settled: when the last switched actuator has settled, by its travel time [s].
        """
        if self.taken >= 0 and self._stages[self.taken].mark >= 0:
            self.stages, self.planned = 0, True
        skipped = range(self.taken + 1, index)
        as_planned = before == self.state(self.taken) and all(self._states[k] == before for k in skipped)
        self.planned = self.planned and as_planned
        self.stages += switched
        self.record_begun(index)
        self.taken = index
        stage = self._stages[index]
        if stage.mark >= 0:
            self.mark = stage.mark
        self._settles = max(self.begin + stage.settled, settled) if stage.mark >= 0 else None

    def settle(self, now: float) -> bool:
        """Settles the mark reached if its time has come; returns whether it did."""
        if self._settles is None or now < self._settles - EPSILON:
            return False
        self._settles = None
        return True

    @property
    def waiting(self) -> bool:
        """Whether the mark reached has not settled yet."""
        return self._settles is not None

    @property
    def idle(self) -> bool:
        """Whether all stages so far were taken, and the last mark has settled."""
        return self.taken == len(self._stages) - 1 and self._settles is None

    def find_end(self, clock: float) -> End | None:
        """Returns how an idle program ends; None while it waits for further stages. Call every period.

        Args:
            clock: awake time of the executor [s]; its own stall is no delay of the planner.
        """
        name = self.program.name
        if self.final:
            return End("done", "all stages have settled", f"holding; {name} is done")
        if self._waits_since is None:
            self._waits_since = clock
        if clock - self._waits_since <= FED_WITHIN:
            return None
        return End("aborted", f"{STARVED}; the arm holds", f"holding; {name} was aborted: {STARVED}")

    def replace(self, message: Replacement, most: int, actuators: int) -> None:
        """Replaces the stages from `message.first` on, see `Replacement`.

        Raises:
            StageMisfit: the stages do not fit; nothing has changed.
        """
        first = message.first
        if message.generation <= self._generation:
            raise StageMisfit("it is older than the last replacement")
        if not self._begun < first <= len(self._stages):
            raise StageMisfit(f"stage {first} has begun, or is not the next to append")
        if first + len(message.stages) > MOST_PROGRAM_STAGES:
            raise StageMisfit(f"a program may have {MOST_PROGRAM_STAGES} stages")
        earliest = self._at[first - 1] if first else -1e12
        start = checked_states(message.start, actuators)
        if self._locked.aligned(start) != self.state(first - 1):
            raise StageMisfit("its stages were planned from other states")
        check_stages(message.stages, start, earliest, most, self._locked.mask, actuators)
        self._generation, self.final = message.generation, message.final
        self.strict |= message.strict
        if message.stages:
            self._waits_since = None
        self._stages[first:] = message.stages
        self._states[first:] = [self._locked.aligned(unpack(stage.states)) for stage in message.stages]
        self._at[first:] = [stage.at for stage in message.stages]


def check_stages(stages: Sequence[Stage], before: int, earliest: float, most: int, locked: int, actuators: int) -> None:
    """Checks successive stages.

    Args:
        stages: stages to check.
        before: states before the first stage.
        earliest: earliest time of the first stage, from the program's zero of time [s].
        most: actuators that may switch at once.
        locked: mask of the locked actuators.
        actuators: number.

    Raises:
        StageMisfit: a stage does not fit; the text says why.
    """
    for k, stage in enumerate(stages):
        states = checked_states(stage.states, actuators)
        differ = states ^ before
        if differ & locked:
            raise StageMisfit(f"stage {k} switches a locked actuator", locked=True)
        if differ.bit_count() > most:
            raise StageMisfit(f"stage {k} switches {differ.bit_count()} actuators, {most} may switch at once")
        if stage.at < earliest:
            raise StageMisfit(f"stage {k} begins before the stage before it")
        before, earliest = states, stage.at


def checked_states(states: bytes, actuators: int) -> int:
    """Returns packed states as an integer.

    Raises:
        StageMisfit: they are states of another number of actuators.
    """
    bits = unpack(states)
    if len(states) != (actuators + 7) // 8 or bits >> actuators:
        raise StageMisfit(f"states of {actuators} actuators are needed")
    return bits
