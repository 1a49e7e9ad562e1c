"""Progress and result of a program, or progress of a set-point: which stage is due. `motion` does the switching."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hyperbit.controller.executor.arm.kinds import indices, merged
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.program import (
    MOST_CHANGES,
    MOST_PROGRAM_STAGES,
    MOST_TRAVELS,
    Change,
    Counted,
    Ended,
    Program,
    Replacement,
    Setpoint,
    Stage,
    Travel,
    Up,
    unpack,
)

EPSILON = 1e-9  # [s]
MOST_AHEAD = 1_000  # stages that may be skipped at once
FED_WITHIN = 10.0  # [s]; a program that waits for its next stages for longer is aborted
MOST_STORED = 1_000  # results
STARVED = f"the planner sent no further stages for {FED_WITHIN:g} s"


class End(NamedTuple):
    """How a program or stream ended by itself; `reason` is for the mode."""

    status: str
    message: str
    reason: str


class StageMisfit(ValueError):
    """Stages do not fit the arm or the running program; the text says why. `locked`: because of a locked actuator."""

    def __init__(self, reason: str, locked: bool = False) -> None:
        super().__init__(reason)
        self.locked = locked


class ProgramExecution:
    """The progress of a running program, whose stages were checked.

    Attributes:
        begin: zero of the program's time [s].
        begun: index of the last stage whose commit was begun; -1 before the first. It can no longer be replaced.
        taken: index of the last stage that the outputs have reached; -1 before the first.
        mark: the last mark reached; -1 before the first.
        stages: number of stages that switched something since the previous mark.
        strict: no stage is skipped, and none begins before the previous one has settled.
        final: no more stages will come.
        trial: mask of the one actuator that a trial moves; 0 for every other program.
        watch: the inputs since the switch of a trial; None before.
    """

    def __init__(self, program: Program, begin: float, locked: LockedActuators, trial: int = 0) -> None:
        self.program, self.begin, self.trial = program, begin, trial
        self.strict, self.final = program.strict, program.final
        self.begun = self.taken = self.mark = -1
        self.switches = self.stages = 0
        self.planned = True  # whether all stages since the previous mark were taken as planned
        self.travels: list[Travel] = []  # travel times measured so far
        self.verified = True  # whether an end-stop or a read-back has confirmed each switched actuator
        self.watch: InputWatch | None = None
        self._generation = -1
        self._stages = list(program.stages)
        self._locked = locked
        self._states = [locked.aligned(unpack(stage.states)) for stage in program.stages]
        self._at = [stage.at for stage in program.stages]
        self._start = locked.aligned(unpack(program.start))
        self._settles: float | None = None  # when the mark reached settles [s]
        self._waits_since: float | None = None  # start of the wait for further stages [s, awake time]

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

    def due(self, now: float, outputs: int, most: int) -> int | None:
        """Returns the index of the stage to switch to now, or None. Overdue stages are skipped, unless `strict`.

        The result is the latest due stage within `most` switches from the commanded states `outputs`, otherwise the
        next one.
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

    def record_reached(self, index: int, before: int, switched: bool, settled: float) -> None:
        """Records that the outputs have reached a stage from the states `before`; it settles at `settled` [s]."""
        if self.taken >= 0 and self._stages[self.taken].mark >= 0:
            self.stages, self.planned = 0, True
        skipped = range(self.taken + 1, index)
        as_planned = before == self.state(self.taken) and all(self._states[k] == before for k in skipped)
        self.planned = self.planned and as_planned
        self.stages += switched
        self.begun = max(self.begun, index)
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
    def idle(self) -> bool:
        """Whether all stages so far were taken, and the last mark has settled."""
        return self.taken == len(self._stages) - 1 and self._settles is None

    def find_end(self, clock: float) -> End | None:
        """Returns how an idle program ends; None while it waits for further stages. Call every period.

        `clock` is the executor's awake time [s]: its own stall is no delay of the planner.
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
        """Replaces stages, see `Replacement`. Raises StageMisfit and changes nothing if the stages do not fit."""
        first = message.first
        if message.generation <= self._generation:
            raise StageMisfit("it is older than the last replacement")
        if not self.begun < first <= len(self._stages):
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
    """Raises StageMisfit if stages do not fit. The first begins from `before`, not before the time `earliest` [s]."""
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
    """Returns packed states as an integer. Raises StageMisfit for another number of actuators."""
    bits = unpack(states)
    if len(states) != (actuators + 7) // 8 or bits >> actuators:
        raise StageMisfit(f"states of {actuators} actuators are needed")
    return bits


class InputWatch:
    """The input lines since the switch of a trial, with the times of their frames on the bus.

    Args:
        levels: before the switch, as a mask of lines.
        at: time of the switch [s].
    """

    def __init__(self, levels: int, at: float) -> None:
        self.before = self._levels = levels
        self.changes: list[Change] = []
        self._at = at

    def see(self, levels: int, known: int, at: float) -> None:
        """Takes the levels of the lines that are known at a time [s]."""
        for line in indices((levels ^ self._levels) & known):
            if len(self.changes) < MOST_CHANGES:
                self.changes.append(Change(line, levels >> line & 1, max(at - self._at, 0.0)))
        self._levels = merged(known, levels, self._levels)


class SetpointStream:
    """The latest set-point of a stream. The constructor raises StageMisfit if a stage does not fit the arm.

    Attributes:
        until: time after which the stream counts as stopped [s].
        reason: sentence on the set-point, for the mode.
        start: states from which the stages were planned, with the locked states of locked actuators.
        stages: states at the end of each stage, likewise; empty: do not move.
    """

    def __init__(self, message: Setpoint, most: int, locked: LockedActuators, actuators: int) -> None:
        self.number, self.until, self.reason = message.stream, message.until, message.reason
        self.strict = message.strict  # no stage is skipped
        before = checked_states(message.start, actuators)
        self.start, self.stages = locked.aligned(before), list[int]()
        for states in (checked_states(packed, actuators) for packed in message.stages):
            if (states ^ before) & locked.mask:
                raise StageMisfit("a set-point switches a locked actuator", locked=True)
            if (states ^ before).bit_count() > most:
                raise StageMisfit(f"a stage of a set-point switches more than {most} actuators at once")
            self.stages.append(locked.aligned(states))
            before = states

    def due(self, outputs: int, most: int) -> int | None:
        """Returns the index of the stage to switch to; None without stages, or if planned from other states."""
        if not self.stages or self.start != outputs:
            return None
        if self.strict:
            return 0
        near = (k for k, states in enumerate(self.stages) if (states ^ outputs).bit_count() <= most)
        return max(near, default=0)


class ProgramResults:
    def __init__(self, send: Callable[[Up], None], journal: SwitchJournal) -> None:
        self.stored: dict[int, Ended] = {}  # by number
        self._send, self._journal = send, journal
        self._number = 0

    def add(self, execution: ProgramExecution, status: str, message: str, measured: bytes, known: bytes) -> None:
        """Sends the single result of a program after the counts, and stores it."""
        self._number += 1
        program, watch = execution.program, execution.watch
        result = self.stored[self._number] = Ended(
            result=self._number,
            program=program.program,
            context=program.context,
            status=status,  # type: ignore[arg-type]
            message=message[:1_000],
            mark=execution.mark,
            switches=execution.switches,
            measured=measured,
            known=known,
            travels=tuple(execution.travels[:MOST_TRAVELS]),
            verified=execution.verified,
            inputs=b"" if watch is None else watch.before.to_bytes((watch.before.bit_length() + 7) // 8, "little"),
            changes=() if watch is None else tuple(watch.changes),
        )
        if len(self.stored) > MOST_STORED:  # the planner sends no acknowledgements
            del self.stored[min(self.stored)]
        self.send_counts()
        self._send(result)

    def send_counts(self) -> None:
        self._send(Counted(tuple(self._journal.counts)))

    def send_again(self) -> None:
        for result in self.stored.values():
            self._send(result)
