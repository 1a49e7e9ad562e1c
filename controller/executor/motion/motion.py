"""The motion on the boards: the running program, or the set-point that is followed; never both."""

from collections.abc import Callable
from enum import Enum, auto

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.bits import first, merged
from hyperbit.controller.executor.arm.kinds import Kinds
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.motion.actuation import Actuation, CommitOutcome
from hyperbit.controller.executor.motion.clearance import ClearanceQuestions
from hyperbit.controller.executor.motion.motion_supervision import Finding, MotionSupervision
from hyperbit.controller.executor.motion.program_execution import EPSILON, End, ProgramExecution
from hyperbit.controller.executor.motion.readings import Readings
from hyperbit.controller.executor.motion.results import ProgramResults
from hyperbit.controller.executor.motion.setpoint_stream import SetpointStream
from hyperbit.controller.executor.motion.travel_times import TravelTimes
from hyperbit.controller.program import MOST_TRAVELS, Begun, Settled, Up, pack
from hyperbit.drivers.canopen.run.master import Master

REALIGNMENT = -1  # in place of the index of a stage


class StageBegin(Enum):
    """What became of a stage that is due.

    Attributes:
        BEGUN: its switch has begun, or its states were reached already.
        WAITS: it is tried again at the next tick: for actuators, the boards, or the planner's answer.
        NOT_CLEAR: it touches what `ArmMotion.clearances.touched` says.
    """

    BEGUN = auto()
    WAITS = auto()
    NOT_CLEAR = auto()


class ArmMotion:
    """Switches the boards to the stages of the running program or stream, and supervises the actuators.

    Attributes:
        execution: progress of the running program; None if none runs.
        stream: stream of set-points; None if none is followed.
        kinds: outputs and end-stops of the actuators.
        actuation: switches the outputs.
        readings: what end-stops and outputs tell.
        supervision: compares end-stops with commanded states.
        clearances: questions to the planner.
        clock: awake time of the executor at the last event [s].

    Args:
        arm: the arm.
        master: CANopen master of the boards.
        journal: counts switches.
        locked: the locked actuators.
        results: sends the result of each program.
        send: sends a message to the planner, if there is one.
    """

    def __init__(
        self,
        arm: ExecutedArm,
        master: Master,
        journal: SwitchJournal,
        locked: LockedActuators,
        results: ProgramResults,
        send: Callable[[Up], None],
    ) -> None:
        self.execution: ProgramExecution | None = None
        self.stream: SetpointStream | None = None
        self.kinds = Kinds(arm.wiring, arm.timing)
        self.actuation = Actuation(master, arm, self.kinds, journal)
        places = [channel.place for channel in arm.wiring.channels]
        self.supervision = MotionSupervision(master, places, self.kinds)
        self.readings = Readings(master, self.kinds, self.actuation, locked, len(arm.actuators))
        self._travel_times = TravelTimes()
        self.clearances = ClearanceQuestions(send, len(arm.actuators))
        self.clock = 0.0
        self._arm, self._master, self._locked, self._results, self._send = arm, master, locked, results, send
        self._index, self._before = 0, 0  # the stage whose commit runs; states before it
        self._homes = False  # whether actuators of unknown state travel to a known one
        self._ended: tuple[ProgramExecution, str, str] | None = None  # its result waits for the running commit

    # --- what moves

    @property
    def moving(self) -> bool:
        """Whether a switched actuator has not arrived."""
        return self.supervision.moving(self.readings.ends, self.clock)

    @property
    def busy(self) -> bool:
        """Whether a commit is under way."""
        return self.actuation.target is not None

    @property
    def committing(self) -> bool:
        """Whether frames of a commit still wait to be sent."""
        return self.busy and self._master.committing

    def supervise(self, now: float) -> list[Finding]:
        """Returns new findings of the motion supervision. Call every period."""
        return self.supervision.tick(self.readings.ends, self._master.known, self.clock, now)

    def adopt(self, now: float) -> None:
        """Adopts outputs and end-stops as they are now; switches nothing."""
        self._travel_times.forget(-1)
        self.actuation.adopt(self.readings.read, self.readings.definite, now)

    # --- begin and end

    def run(self, execution: ProgramExecution) -> None:
        """Starts a program in place of what runs. Only `Modes.run` calls this, since the mode changes too."""
        self._end("replaced", f"replaced by {execution.program.name}")
        self.execution = execution

    def follow(self, stream: SetpointStream) -> None:
        """Follows a set-point in place of a program or of the last set-point. Only `Modes.follow` calls this.

        While a question about the last set-point is open, its stages are kept. Otherwise each answer would belong to
        the previous set-point.
        """
        if self.execution is not None:
            self._end("replaced", "replaced by a setpoint")
        last = self.stream
        if last is not None and self.clearances.waiting and stream.stages and stream.start == last.start:
            last.until, last.reason, last.number = stream.until, stream.reason, stream.number
        else:
            self.stream = stream
            self.clearances.forget()

    def hold(self, status: str, message: str) -> None:
        """Ends program and stream, and gives up a commit whose SYNC was not handed out.

        Only `Modes.hold` calls this, since the mode changes too.
        """
        self.actuation.give_up(message or "the arm holds")
        self._end(status, message)

    def _end(self, status: str, message: str) -> None:
        """Ends program and stream. The result waits for the running commit."""
        execution, self.execution, self.stream = self.execution, None, None
        self.clearances.forget()
        self.actuation.rest()
        if execution is None:
            return
        self._ended = execution, status, message
        if not self.busy:
            self.send_result()

    def send_result(self) -> None:
        """Sends the result of a program that has ended."""
        if self._ended is not None:
            execution, status, message = self._ended
            self._ended = None
            try:
                measured, known = self.readings.packed()
            except Exception:  # a defect must not keep a program from its result
                measured = known = pack(0, len(self._arm.actuators))
            self._results.add(execution, status, message, measured, known)

    # --- what is due

    def conclude(self, at: float | None, now: float) -> None:
        """Records the switches and arrivals since the last call. Call after each event.

        Args:
            at: time of the event's frame on the bus [s]; None: unknown.
            now: [s].
        """
        running = self.execution if self._ended is None else self._ended[0]
        for lines, switched_at in self._master.drain_switched():
            mask = self.actuation.record_switched(lines, switched_at)
            self.supervision.record_switched(mask, self.actuation.states, self.readings.ends, self.clock, now)
            self._travel_times.begin(mask, self.actuation.states, self.readings.ends, at)
            if running is not None:
                running.switches += mask.bit_count()
                running.verified &= not mask & self.kinds.trusted
        if self._travel_times.measuring:
            travels = self._travel_times.drain_arrived(self.readings.ends, at)
            if running is not None and len(running.travels) < MOST_TRAVELS:
                running.travels += travels
        commit = self.actuation.conclude(now)
        if not self.committing:
            self.send_result()
        if commit is not None and commit.reached and self._index != REALIGNMENT:
            self._record_reached(commit, now)

    def advance(self, now: float) -> End | None:
        """Starts what is due; returns an end if the program or stream has ended by itself."""
        if self.stream is not None:
            return self._advance_stream(self.stream, now)
        execution = self.execution
        if execution is None:
            return None
        decided = self.supervision.decided(self.readings.ends, self._master.known) and not self.actuation.unproven
        rests = not self.busy and not self.moving and decided
        if execution.waiting and rests and execution.settle(now):
            self._send(self._settled(execution))
        if execution.idle and rests and now >= self.actuation.free_at - EPSILON:
            end = execution.find_end(self.clock)
            if end is not None:
                return end
        return self._advance_program(execution, now) if self._realign(*execution.homed, now) else None

    def _realign(self, homed: int, target: int, now: float) -> bool:
        """Sets the outputs of locked actuators to their locked states, and homes others, before any stage.

        A locked actuator that comes loose then stays in its locked state. A missed pulse is given again.

        Args:
            homed: mask of the actuators to home if their state is unknown.
            target: states to home them to.
            now: [s].

        Returns:
            Whether this is done, so that a stage may begin.
        """
        before, most, missed = self.actuation.states, self._arm.most, self.actuation.missed
        states = self._locked.realigned(before, most)
        homing = first(self.readings.homing & (homed | missed), most - (states ^ before).bit_count())
        states = merged(homing & ~missed, target, states)
        differ = self.actuation.differ(states, homing)
        if differ:
            if not self.busy and now >= self.actuation.ready_at(differ, strict=False) - EPSILON:
                self._index = REALIGNMENT
                if self.actuation.switch(states, now, homing):
                    self._homes |= bool(homing)
            return False
        if self._homes and (self.busy or self.moving or now < self.actuation.free_at - EPSILON):
            return False
        if self._homes and self.execution is not None:
            self.execution.delay(now)
        self._homes = False
        return True

    def _advance_program(self, execution: ProgramExecution, now: float) -> End | None:
        """Begins the due stage of a program; returns an end if the program cannot continue."""
        index = None if self.busy else execution.due(now, self.actuation.states, self._arm.most)
        if index is None:
            return None
        states = execution.state(index)
        if (states ^ self.actuation.states).bit_count() > self._arm.most:
            reason = f"holding; {execution.program.name} was aborted: the outputs are too far from its next stage"
            return End("aborted", "the outputs are too far from the next stage; the arm holds", reason)
        planned = execution.state(execution.taken)
        if self._begin_stage(index, planned, states, execution.strict, now) is not StageBegin.NOT_CLEAR:
            return None
        why = f"the next stage cannot begin: {self.clearances.touched}"
        return End("aborted", f"{why}; the arm holds", f"holding; {execution.program.name} was aborted: {why}")

    def _advance_stream(self, stream: SetpointStream, now: float) -> End | None:
        """Begins the due stage of a stream; returns an end if the stream has stopped."""
        if now > stream.until:
            return End("canceled", "", "holding; the stream of setpoints has stopped")
        if self.busy or (stream.stages and not self._realign(self.kinds.everything, stream.start, now)):
            return None
        index = stream.due(self.actuation.states, self._arm.most)
        if index is None:
            self.clearances.forget()
            self.actuation.rest()
        elif now >= self.actuation.free_at and not self.moving:
            begin = self._begin_stage(index, stream.start, stream.stages[index], stream.strict, now)
            if begin is StageBegin.NOT_CLEAR:
                stream.stages = []  # the planner's follower must find other stages
        return None

    def _begin_stage(self, index: int, planned: int, states: int, strict: bool, now: float) -> StageBegin:
        """Starts the switch of a stage if it may begin now.

        Args:
            index: of the stage.
            planned: states from which the stage was planned.
            states: states at the end of the stage.
            strict: the stage begins only when nothing moves and it is known to be clear.
            now: [s].
        """
        self._index, self._before = index, self.actuation.states
        if strict and (self.moving or self.actuation.unproven):
            return StageBegin.WAITS
        if states == self._before:
            self._record_reached(CommitOutcome(states, reached=True), now)
            return StageBegin.BEGUN
        if now < self.actuation.ready_at(self.actuation.differ(states, 0), strict) - EPSILON:
            return StageBegin.WAITS
        if strict and (start := self._start_of(states)) not in (planned, states):
            if not self.clearances.ask(start, states, now):
                self.clearances.waits += 1
                self.actuation.rest()
                return StageBegin.WAITS
            if self.clearances.touched is not None:
                return StageBegin.NOT_CLEAR
        if not self.actuation.switch(states, now):
            return StageBegin.WAITS
        self.clearances.forget()  # if the stage must begin again, obstacles may have changed
        if self.execution is not None:
            self.execution.record_begun(index)
        return StageBegin.BEGUN

    def _start_of(self, states: int) -> int:
        """Returns the states from which a stage moves to `states`: a stuck actuator may come free during the stage."""
        measured = self.readings.measured
        return merged(measured ^ states, measured, self._before)

    def _record_reached(self, commit: CommitOutcome, now: float) -> None:
        """Records that the outputs have reached the stage begun last."""
        self.supervision.await_anew(commit.states, self.readings.ends, self.clock, now)
        execution, stream = self.execution, self.stream
        if stream is not None and self._index < len(stream.stages) and stream.stages[self._index] == commit.states:
            stream.record_reached(self._index)
        if execution is not None:
            switched = commit.states != self._before
            execution.record_reached(self._index, self._before, switched, self.actuation.free_at)
            self._send(Begun(execution.program.program, self._index, execution.switches))

    def _settled(self, execution: ProgramExecution) -> Settled:
        counted = execution.switches, execution.stages
        return Settled(execution.program.program, execution.mark, *self.readings.packed(), *counted, execution.planned)
