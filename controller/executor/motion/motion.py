"""The motion on the boards: the running program, or the followed set-point; never both."""

from collections.abc import Callable

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.kinds import Kinds, first, merged
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.motion.actuation import Actuation
from hyperbit.controller.executor.motion.motion_supervision import MotionSupervision
from hyperbit.controller.executor.motion.program_execution import (
    EPSILON,
    End,
    InputWatch,
    ProgramExecution,
    ProgramResults,
    SetpointStream,
)
from hyperbit.controller.executor.motion.readings import Readings, TravelTimes
from hyperbit.controller.program import MOST_TRAVELS, Begun, Clearance, Question, Settled, Up, pack
from hyperbit.drivers.canopen.run.master import Master

ANSWER_WITHIN = 10.0  # [s]; without an answer the stage counts as not clear
REALIGNMENT = -1  # in place of the index of a stage


class ClearanceQuestions:
    """Questions to the planner, one at a time: does a stage touch an obstacle if it begins from unplanned states?"""

    def __init__(self, send: Callable[[Up], None], actuators: int) -> None:
        # what the stage of the last question touches, in words; None if the stage is clear
        self.touched: str | None = None
        self.waits = 0  # number of periods in which the arm waited for an answer
        self._send, self._actuators = send, actuators
        self._number = 0
        self._way: tuple[int, int] | None = None
        self._asked_at = 0.0
        self._answered = False

    @property
    def waiting(self) -> bool:
        return self._way is not None and not self._answered

    def ask(self, start: int, stage: int, now: float) -> bool:
        """Asks the planner about `stage` from `start`, once; returns whether `touched` has the answer."""
        if (start, stage) != self._way:
            self._number += 1
            self._way, self._answered, self._asked_at = (start, stage), False, now
            self._send(Question(self._number, pack(start, self._actuators), pack(stage, self._actuators)))
        if not self._answered and now - self._asked_at > ANSWER_WITHIN:
            unknown = f"the planner did not tell within {ANSWER_WITHIN:g} s whether the stage is clear"
            self.receive_answer(Clearance(self._number, unknown))
        return self._answered

    def receive_answer(self, message: Clearance) -> None:
        if message.question == self._number and self._way is not None:
            self._answered, self.touched = True, message.touched

    def forget(self) -> None:
        self._way, self._answered = None, False


class ArmMotion:
    """Switches the boards to the stages of the running program or stream, and supervises the actuators."""

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
        self.supervision = MotionSupervision(master, [channel.place for channel in arm.wiring.channels], self.kinds)
        self.readings = Readings(master, self.kinds, self.actuation, locked)
        self._travel_times = TravelTimes()
        self.clearances = ClearanceQuestions(send, len(arm.actuators))
        self.clock = 0.0  # awake time of the executor at the last event [s]
        self._arm, self._master, self._locked, self._results, self._send = arm, master, locked, results, send
        self._index, self._before = 0, 0  # the stage whose commit runs; states before it
        self._homes = False  # whether actuators of unknown state travel to a known one
        self._ended: tuple[ProgramExecution, str, str] | None = None  # its result waits for the running commit

    # --- what moves

    @property
    def moving(self) -> bool:
        return self.supervision.moving(self.clock)

    @property
    def busy(self) -> bool:
        return self.actuation.target is not None

    @property
    def committing(self) -> bool:
        return self.busy and self._master.switching.under_way

    def adopt(self, now: float) -> None:
        self._travel_times.forget(-1)
        self.actuation.adopt(self.readings.read, self.readings.definite, now)

    def check(self) -> None:
        """Asserts what must hold after each step, see `Executor.check`."""
        execution, actuation = self.execution, self.actuation
        assert execution is None or self.stream is None, "a program and a stream run at once"
        assert execution is None or (execution.mark >= -1 and execution.taken <= execution.begun)
        assert self._ended is None or self.committing, "a result waits for no commit"
        assert not actuation.uncertain & ~self.kinds.paired, "an actuator with one output is uncertain"
        assert not actuation.missed & ~actuation.uncertain, "a missed pulse is believed"

    # --- begin and end

    def run(self, execution: ProgramExecution) -> None:
        """Starts a program in place of the present motion. Only `Modes.run` calls this, since the mode changes too."""
        self.end("replaced", f"replaced by {execution.program.name}")
        self.execution = execution

    def follow(self, stream: SetpointStream) -> None:
        """Follows a set-point in place of a program or of the last set-point. Only `Modes.follow` calls this.

        While a question about the last set-point is open, its stages are kept. Otherwise each answer would belong to
        the previous set-point.
        """
        if self.execution is not None:
            self.end("replaced", "replaced by a setpoint")
        last = self.stream
        if last is not None and self.clearances.waiting and stream.stages and stream.start == last.start:
            last.until, last.reason, last.number = stream.until, stream.reason, stream.number
        else:
            self.stream = stream
            self.clearances.forget()

    def end(self, status: str, message: str) -> None:
        """Ends program and stream. The result waits for the running commit. Other rooms call `Modes.hold`."""
        execution, self.execution, self.stream = self.execution, None, None
        self.clearances.forget()
        self.actuation.busy_since = None
        if execution is None:
            return
        self._ended = execution, status, message
        if not self.busy:
            self.send_result()

    def send_result(self) -> None:
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

        `at`: time of the event's frame on the bus [s]; None: unknown.
        """
        running = self.execution if self._ended is None else self._ended[0]
        for lines, switched_at in self._master.switching.drain():
            mask = self.actuation.record_switched(lines, switched_at)
            self.supervision.record_switched(mask, self.actuation.states, self.clock, now)
            self._travel_times.begin(mask, self.actuation.states, self.readings.ends, at)
            if running is not None:
                running.switches += mask.bit_count()
                running.verified &= not mask & self.kinds.trusted
                if running.trial & mask:
                    running.watch = InputWatch(self._master.inputs.ends, switched_at if at is None else at)
        if any(self._travel_times.travelling):
            travels = self._travel_times.drain_arrived(self.readings.ends, at)
            if running is not None and len(running.travels) < MOST_TRAVELS:
                running.travels += travels
        if running is not None and running.watch is not None:
            running.watch.see(self._master.inputs.ends, self._master.inputs.up, now if at is None else at)
        reached = None if self.actuation.target is None else self.actuation.conclude(now)
        if self._ended is not None and not self.committing:
            self.send_result()
        if reached is not None and self._index != REALIGNMENT:
            self._record_reached(reached, now)

    def advance(self, now: float) -> End | None:
        """Starts due actions; returns an end if the program or stream has ended by itself."""
        if self.stream is not None:
            return self._advance_stream(self.stream, now)
        execution = self.execution
        if execution is None:
            return None
        concerned = execution.trial or self.kinds.everything
        if self.actuation.missed & execution.trial and execution.switches and not self.busy:
            reason = f"holding; {execution.program.name}: its pulse was over before it was read back"
            return End("aborted", "its pulse was over before it was read back; the arm holds", reason)
        decided = self.supervision.decided() and not self.actuation.unproven & concerned
        rests = not self.busy and not self.moving and decided
        if rests and execution.settle(now):
            program, counted = execution.program.program, (execution.switches, execution.stages)
            packed = self.readings.packed()
            self._send(Settled(program, execution.mark, *packed, *counted, execution.planned))
        if execution.idle and rests and now >= self.actuation.free_at - EPSILON:
            end = execution.find_end(self.clock)
            if end is not None:
                return end
        return self._advance_program(execution, now) if self._realign(*execution.homed, now) else None

    def _realign(self, homed: int, target: int, now: float) -> bool:
        """Sets the outputs of locked actuators to their locked states, and homes others, before any stage.

        A locked actuator that comes loose then stays in its locked state. A missed pulse is given again. Actuators of
        unknown state in the mask `homed` are homed to `target`. Returns whether a stage may begin.
        """
        before, most, missed = self.actuation.states, self._arm.most, self.actuation.missed
        states, execution = self._locked.realigned(before, most), self.execution
        if execution is not None and execution.trial:  # it switches one actuator once, and nothing else
            states, missed, homed = before, 0, 0 if execution.switches else execution.trial
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
        if self._homes and self.execution is not None and self.execution.taken < 0:
            self.execution.begin = max(self.execution.begin, now)  # its first stage was due before homing ended
        self._homes = False
        return True

    def _advance_program(self, execution: ProgramExecution, now: float) -> End | None:
        index = None if self.busy else execution.due(now, self.actuation.states, self._arm.most)
        if index is None:
            return None
        states = execution.state(index)
        if (states ^ self.actuation.states).bit_count() > self._arm.most:
            reason = f"holding; {execution.program.name} was aborted: the outputs are too far from its next stage"
            return End("aborted", "the outputs are too far from the next stage; the arm holds", reason)
        planned = execution.state(execution.taken)
        if self._begin_stage(index, planned, states, execution.strict, now):
            return None
        why = f"the next stage cannot begin: {self.clearances.touched}"
        return End("aborted", f"{why}; the arm holds", f"holding; {execution.program.name} was aborted: {why}")

    def _advance_stream(self, stream: SetpointStream, now: float) -> End | None:
        if now > stream.until:
            return End("canceled", "", "holding; the stream of setpoints has stopped")
        if self.busy or (stream.stages and not self._realign(self.kinds.everything, stream.start, now)):
            return None
        index = stream.due(self.actuation.states, self._arm.most)
        if index is None:
            self.clearances.forget()
            self.actuation.busy_since = None
        elif now < self.actuation.free_at or self.moving:
            return None
        elif not self._begin_stage(index, stream.start, stream.stages[index], stream.strict, now):
            stream.stages = []  # the planner must find other stages
        return None

    def _begin_stage(self, index: int, planned: int, states: int, strict: bool, now: float) -> bool:
        """Starts the switch of a stage to `states` if it may begin now; otherwise the next tick tries again.

        A strict stage begins only when nothing moves, and from the states from which it was planned, unless the planner
        knows that it is clear. Returns False if it touches an obstacle; then `clearances.touched` names it.
        """
        self._index, self._before = index, self.actuation.states
        if strict and (self.moving or self.actuation.unproven):
            return True
        if states == self._before:
            self._record_reached(states, now)
            return True
        if now < self.actuation.ready_at(self.actuation.differ(states, 0), strict) - EPSILON:
            return True
        if strict:
            measured = self.readings.measured
            start = merged(measured ^ states, measured, self._before)  # a stuck actuator may come free in the stage
            if start not in (planned, states):
                if not self.clearances.ask(start, states, now):
                    self.clearances.waits += 1
                    self.actuation.busy_since = None
                    return True
                if self.clearances.touched is not None:
                    return False
        if self.actuation.switch(states, now):
            self.clearances.forget()  # if the stage must begin again, obstacles may have changed
            if self.execution is not None:
                self.execution.begun = max(self.execution.begun, index)
        return True

    def _record_reached(self, states: int, now: float) -> None:
        self.supervision.await_anew(states, self.clock, now)
        execution, stream, index = self.execution, self.stream, self._index
        if stream is not None and index < len(stream.stages) and stream.stages[index] == states:
            stream.start, stream.stages = states, stream.stages[index + 1 :]
        if execution is not None:
            execution.record_reached(index, self._before, states != self._before, self.actuation.free_at)
            self._send(Begun(execution.program.program, index, execution.switches))
