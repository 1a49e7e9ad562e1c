"""One motion program: which stage is due when, and which mark has settled. It only reckons; `motion` acts."""

from bisect import bisect_right
from collections.abc import Sequence

from controller.executor.locked import LockedActuators
from controller.program import MOST_PROGRAM_STAGES, Program, Replacement, Stage, Travel, unpack

EPSILON = 1e-9  # [s]
MOST_AHEAD = 1_000  # stages that may be left out at once


class Misfit(ValueError):
    """Stages are refused. `cause` is one of `Declined`."""

    def __init__(self, reason: str, locked: bool = False) -> None:
        """Takes the reason, and whether a locked actuator is it."""
        super().__init__(reason)
        self.locked = locked


class ProgramExecution:
    """The progress of a running program.

    Attributes:
        program: as it was sent.
        begin: its zero of time [s].
        taken: index of the last stage that the outputs have reached; -1 before the first.
        mark: the last mark reached, -1 if none.
        switches: actuators switched so far.
        stages: stages switched since the mark before.
        planned: whether all stages since the mark before were taken as planned.
        travels: the ways of actuators that were measured so far.
        strict: no stage is left out or begins before the one before has settled.

    Args:
        program: with stages that were checked.
        begin: see above.
        locked: the locked actuators; every stage has them in their states.
    """

    def __init__(self, program: Program, begin: float, locked: LockedActuators) -> None:
        self.program, self.begin = program, begin
        self.strict, self.final = program.strict, program.final
        self.taken = self.mark = -1
        self.switches = self.stages = 0
        self.planned = True
        self.travels: list[Travel] = []
        self._generation = -1
        self._begun = -1  # the last stage whose commit was begun
        self._stages = list(program.stages)
        self._locked = locked
        self._states = [locked.aligned(unpack(stage.states)) for stage in program.stages]
        self._at = [stage.at for stage in program.stages]
        self._start = locked.aligned(unpack(program.start))
        self._settles: float | None = None  # when the mark reached settles [s]

    def state(self, index: int) -> int:
        """Returns the states in which a stage ends; of stage -1 those from which the program was planned."""
        return self._start if index < 0 else self._states[index]

    @property
    def homed(self) -> tuple[int, int]:
        """Mask of the actuators that are brought to a state before the first stage if theirs is unknown; that state."""
        if self.program.homed:
            return unpack(self.program.homed), self._states[-1] if self._states else self._start
        return -1, self._start

    def delay(self, now: float) -> None:
        """Begins now, if the time for the first stage has come before actuators were homed."""
        if self.taken < 0:
            self.begin = max(self.begin, now)

    def due(self, now: float, outputs: int, most: int) -> int | None:
        """Returns the stage to switch to now: the latest whose time has come, for nothing old is made up for.

        Args:
            now: [s].
            outputs: states.
            most: actuators that may switch at once. If no later stage is so near, the next one is due.
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

    def begins(self, index: int) -> None:
        """Notes that the commit of a stage has begun: it can no longer be replaced."""
        self._begun = max(self._begun, index)

    def took(self, index: int, before: int, switched: bool, settled: float) -> None:
        """Notes that the outputs have reached a stage.

        Args:
            index: of the stage.
            before: outputs before it.
            switched: whether anything has.
            settled: when the last switch has settled, by travel time [s].
        """
        if self.taken >= 0 and self._stages[self.taken].mark >= 0:
            self.stages, self.planned = 0, True
        skipped = range(self.taken + 1, index)
        as_planned = before == self.state(self.taken) and all(self._states[k] == before for k in skipped)
        self.planned = self.planned and as_planned
        self.stages += switched
        self.begins(index)
        self.taken = index
        stage = self._stages[index]
        if stage.mark >= 0:
            self.mark = stage.mark
        self._settles = max(self.begin + stage.settled, settled) if stage.mark >= 0 else None

    def settles(self, now: float) -> bool:
        """Returns whether the mark reached is settled by time; once."""
        if self._settles is None or now < self._settles - EPSILON:
            return False
        self._settles = None
        return True

    @property
    def waiting(self) -> bool:
        """Whether the mark reached has not settled yet."""
        return self._settles is not None

    @property
    def finished(self) -> bool:
        """Whether all stages were taken, no more come, and the last mark has settled."""
        return self.final and self.taken == len(self._stages) - 1 and self._settles is None

    def replace(self, message: Replacement, most: int, actuators: int) -> None:
        """Takes other stages from `message.first` on, see `Replacement`.

        Raises:
            Misfit: they do not fit; nothing has changed.
        """
        first = message.first
        if message.generation <= self._generation:
            raise Misfit("it is older than the last replacement")
        if not self._begun < first <= len(self._stages):
            raise Misfit(f"stage {first} has begun, or is not the next to append")
        if first + len(message.stages) > MOST_PROGRAM_STAGES:
            raise Misfit(f"a program may have {MOST_PROGRAM_STAGES} stages")
        earliest = self._at[first - 1] if first else -1e12
        start = checked_states(message.start, actuators)
        if self._locked.aligned(start) != self.state(first - 1):
            raise Misfit("its stages were planned from other states")
        check_stages(message.stages, start, earliest, most, self._locked.mask, actuators)
        self._generation, self.final = message.generation, message.final
        self.strict |= message.strict
        self._stages[first:] = message.stages
        self._states[first:] = [self._locked.aligned(unpack(stage.states)) for stage in message.stages]
        self._at[first:] = [stage.at for stage in message.stages]


def check_stages(stages: Sequence[Stage], before: int, earliest: float, most: int, locked: int, actuators: int) -> None:
    """Checks stages that follow on states.

    Args:
        stages: to check.
        before: states that they follow on.
        earliest: the first may begin then at the earliest, after the program's zero of time [s].
        most: actuators that may switch at once.
        locked: mask of the locked actuators.
        actuators: number.

    Raises:
        Misfit: they do not fit; the text says why.
    """
    for k, stage in enumerate(stages):
        states = checked_states(stage.states, actuators)
        differ = states ^ before
        if differ & locked:
            raise Misfit(f"stage {k} switches a locked actuator", locked=True)
        if differ.bit_count() > most:
            raise Misfit(f"stage {k} switches {differ.bit_count()} actuators, {most} may switch at once")
        if stage.at < earliest:
            raise Misfit(f"stage {k} begins before the stage before it")
        before, earliest = states, stage.at


def checked_states(states: bytes, actuators: int) -> int:
    """Returns packed states as an integer.

    Raises:
        Misfit: they are not of so many actuators.
    """
    bits = unpack(states)
    if len(states) != (actuators + 7) // 8 or bits >> actuators:
        raise Misfit(f"states of {actuators} actuators are needed")
    return bits
