"""The requests of clients: programs, trials, set-points, cancel, stop, reset, lock, faults to play."""

import logging
from typing import NamedTuple

from hyperbit.controller import program
from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.kinds import merged
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.core.clients import Clients
from hyperbit.controller.executor.core.events import Act, ClientId, FaultPlayed, ToClient, ToSimulation
from hyperbit.controller.executor.core.modes import Modes
from hyperbit.controller.executor.motion.motion import ArmMotion
from hyperbit.controller.executor.motion.program_execution import (
    ProgramExecution,
    SetpointStream,
    StageMisfit,
    check_stages,
    checked_states,
)
from hyperbit.controller.host.process import Log
from hyperbit.controller.program import pack
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, no_motion

# what each role but the planner may send here; a planner may send all but a trial
OPERATORS = (program.Stop,)
COMMISSIONERS = (program.Alive, program.Trial, program.Cancel, program.Stop, program.Reset, program.PlayFault)


class HeldAnswer(NamedTuple):
    """A delayed answer to a stop or cancel. It is sent when nothing can switch any more, at `until` [s] at the latest.

    `switches`: the executor's number of switches when the request came.
    """

    client: ClientId
    request: int
    done: str
    follows: str
    switches: int
    until: float


class ClientRequests:
    """Handles the messages of accepted clients. While `quitting`, it accepts no programs and set-points."""

    def __init__(
        self, arm: ExecutedArm, motion: ArmMotion, locked: LockedActuators, modes: Modes, act: Act, clients: Clients
    ) -> None:
        self.quitting, self._clients = False, clients
        self._arm, self._motion, self._locked, self._modes, self._act = arm, motion, locked, modes, act
        self._size = len(arm.actuators)
        self._program = self._stream = 0  # greatest numbers so far
        self.held: list[HeldAnswer] = []  # delayed answers
        # longest wait of an answer, rounded down to a tick [s]
        self._longest = arm.timing.heartbeat_timeout / 2 - 2 * program.TICK

    @property
    def greatest(self) -> int:
        return max(self._program, self._stream)

    def receive_request(self, client: ClientId, message: program.Down, now: float) -> None:
        """Carries out a request, and answers it now or as soon as nothing switches any more."""
        if (refused := barred(self._clients.roles[client], message)) is not None:
            self._act(ToClient(client, program.Goodbye(refused)))
            return
        match message:
            case program.Program():
                self.receive_program(message, now)
            case program.Trial():
                self._try(message, now)
            case program.Replacement():
                self._replace(message)
            case program.Setpoint():
                self._follow(message, now)
            case program.Clearance():
                self._motion.clearances.receive_answer(message)
            case program.Cancel():
                self._cancel(client, message, now)
            case program.Stop():
                self._stop(client, message, now)
            case program.Reset():
                self._reset(client, message, now)
            case program.Lock():
                self._lock(client, message, now)
            case program.PlayFault():
                if self._modes.simulated:
                    self._act(ToSimulation(client, message.request, message.fault))
                else:
                    self._refuse(client, message.request, Refusal(Reason.NOT_SIMULATED))

    # --- programs and set-points

    def receive_program(self, message: program.Program, now: float) -> None:
        refusal = self._refusal(message, now)
        if refusal is not None:
            self._clients.to_planner(program.Declined(message.program, refusal.data))
            return
        self._program = message.program
        begin = message.begin or now
        self._modes.run(ProgramExecution(message, begin, self._locked))
        self._clients.to_planner(program.Accepted(message.program, begin))

    def _try(self, message: program.Trial, now: float) -> None:
        """Runs a trial as a program of one stage, if nothing else runs or moves."""
        refusal = self._trial_refusal(message, now)
        if refusal is not None:
            self._clients.to_planner(program.Declined(message.program, refusal.data))
            return
        self._program = message.program
        before, bit = self._motion.actuation.states, 1 << message.actuator
        after, size = merged(bit, message.state << message.actuator, before), self._size
        made = program.Program(
            program=message.program,
            epoch=message.epoch,
            start=pack(before, size),
            begin=now,
            stages=(program.Stage(pack(after, size), 0.0, 0, message.watch),),
            final=True,
            strict=False,
            name=f"trial of {self._arm.actuators[message.actuator]}",
            homed=pack(bit, size),
        )
        self._modes.run(ProgramExecution(made, now, LockedActuators(self._arm.actuators), bit))
        self._clients.to_planner(program.Accepted(message.program, now))

    def _trial_refusal(self, message: program.Trial, now: float) -> Refusal | None:
        motion, labels = self._motion, self._arm.actuators
        if (refusal := self._late_refusal(message, now)) is not None:
            return refusal
        if self._modes.mode != "ready" or motion.moving or now < motion.actuation.free_at:
            return Refusal(Reason.PROGRAM_MALFORMED, misfit="a trial waits until nothing else runs or moves")
        if message.actuator >= len(labels):
            return Refusal(Reason.NO_SUCH_ACTUATOR, count=len(labels), index=message.actuator)
        if self._locked.mask >> message.actuator & 1:
            return Refusal(Reason.PROGRAM_LOCKED, misfit=f"{labels[message.actuator]} is locked")
        return Refusal(Reason.SWITCH_NOT_CONFIRMED) if motion.busy else None

    def _late_refusal(self, message: program.Program | program.Trial, now: float) -> Refusal | None:
        """Returns why nothing may begin, or why this request came too late for it."""
        if self.quitting:
            return Refusal(Reason.EXECUTOR_SHUTTING_DOWN)
        if self._modes.mode not in ("ready", "executing"):
            return no_motion(self._modes.mode, self._modes.reason)
        if message.epoch != self._modes.epoch:
            return Refusal(Reason.OVERTAKEN)
        if now > message.until:
            return Refusal(Reason.TOO_LATE_TO_BEGIN)
        if message.program <= self._program:
            return Refusal(Reason.PROGRAM_MALFORMED, misfit=f"a program of number {self._program} came before")
        return None

    def _refusal(self, message: program.Program, now: float) -> Refusal | None:
        if (refusal := self._late_refusal(message, now)) is not None:
            return refusal
        try:
            start = checked_states(message.start, self._size)
            if message.homed:
                checked_states(message.homed, self._size)
            check_stages(message.stages, start, -1e12, self._arm.most, self._locked.mask, self._size)
        except StageMisfit as misfit:
            if misfit.locked:
                return Refusal(Reason.PROGRAM_LOCKED, misfit=str(misfit))
            return Refusal(Reason.PROGRAM_MALFORMED, misfit=str(misfit))
        if self._motion.busy:
            return Refusal(Reason.SWITCH_NOT_CONFIRMED)
        if start != self._motion.actuation.states:
            return Refusal(Reason.MOVED_SINCE_PLANNED)
        return None

    def _replace(self, message: program.Replacement) -> None:
        execution = self._motion.execution
        accepted = execution is not None and execution.program.program == message.program
        if execution is not None and accepted:
            try:
                execution.replace(message, self._arm.most, self._size)
                self._motion.clearances.forget()  # the planner may know other obstacles now
            except StageMisfit as misfit:
                accepted = False
                self._act(Log(logging.INFO, f"replacement of {execution.program.name} refused: {misfit}"))
        self._clients.to_planner(program.Replaced(message.program, message.generation, accepted))

    def _follow(self, message: program.Setpoint, now: float) -> None:
        """Follows a set-point; ignores one of an earlier stream or epoch."""
        old = message.stream <= self._program or message.stream < self._stream or message.epoch != self._modes.epoch
        if old or self.quitting or now > message.until or self._modes.mode not in ("ready", "executing"):
            return
        try:
            stream = SetpointStream(message, self._arm.most, self._locked, self._size)
        except StageMisfit as misfit:
            self._act(Log(logging.WARNING, f"set-point refused: {misfit}"))
            return
        self._stream = message.stream
        self._modes.follow(stream)

    # --- cancel, stop, reset, lock

    def _cancel(self, client: ClientId, message: program.Cancel, now: float) -> None:
        execution, followed = self._motion.execution, self._motion.stream is not None
        if message.program is not None and (execution is None or execution.program.program != message.program):
            self._answer(client, message.request, f"program {message.program} is not running")
            return
        name = "following" if execution is None else execution.program.name
        if message.program is None:
            self._modes.new_epoch()
        done = ("canceled", "") if execution or followed else ("there was no goal to cancel", "the arm holds")
        self._hold_answer(client, message.request, *done, now)
        self._modes.hold("canceled", message.reason or "canceled; the arm holds", f"holding; {name} was canceled")

    def _stop(self, client: ClientId, message: program.Stop, now: float) -> None:
        self._modes.new_epoch()
        self._hold_answer(client, message.request, "stopped", "the arm holds until reset", now)
        self._modes.hold(
            "aborted", "stopped; the arm holds", "a stop was requested; the arm holds until reset", "stopped"
        )

    def _hold_answer(self, client: ClientId, request: int, done: str, follows: str, now: float) -> None:
        self._motion.conclude(None, now)  # switches before the request are not "under way"
        held = HeldAnswer(client, request, done, follows, self._motion.actuation.switches, now + self._longest)
        self.held.append(held)

    def answer_held(self, now: float) -> None:
        """Answers each stop and cancel as soon as no frame under way can switch an actuator any more.

        A bus that has not sent these frames after a part of `heartbeat_timeout` delays no answer; the answer says so.
        Call after each event while answers are held.
        """
        leaving = self._motion.actuation.under_way.bit_count()
        waiting = [held for held in self.held if leaving and now < held.until]
        due = [held for held in self.held if held not in waiting]
        self.held = waiting
        for held in due:
            done = self._motion.actuation.switches - held.switches
            told = f"{_switches(done)} under way" if done else ""
            if leaving:
                told = f"{_switches(done + leaving)} under way, and the bus has not sent {leaving} of them yet"
            text = "; ".join(part for part in (held.done, told, held.follows) if part)
            if held.client in self._clients.roles:
                self._answer(held.client, held.request, text)

    def _reset(self, client: ClientId, message: program.Reset, now: float) -> None:
        if self._modes.mode not in ("fault", "stopped"):
            self._answer(client, message.request, f"nothing to reset: the arm is {self._modes.mode}")
            return
        if message.epoch != self._modes.epoch:
            self._refuse(client, message.request, Refusal(Reason.OVERTAKEN))
            return
        if opened := self._motion.readings.interlock_faults():
            interlock = opened[0].message + (f" (and {len(opened) - 1} more)" if opened[1:] else "")
            self._refuse(client, message.request, Refusal(Reason.INTERLOCK_OPEN, interlock=interlock))
            return
        self._modes.new_epoch()
        self._modes.boot("the boards are being booted after a reset", now)
        self._answer(client, message.request, "resetting; the mode will be ready, or fault with the reason")

    def _lock(self, client: ClientId, message: program.Lock, now: float) -> None:
        motion = self._motion
        refusal = self._locked.refusal(message.actuator, message.state, motion.readings.read, motion.readings.definite)
        mode = self._modes.mode
        if mode == "executing" or motion.moving or motion.busy:
            refusal = Refusal(Reason.LOCK_WHILE_MOVING, mode=mode)
        if refusal is not None:
            self._refuse(client, message.request, refusal)
            return
        self._locked.change(message.actuator, message.state)
        waits = mode in ("fault", "stopped")
        if mode == "ready":
            self._modes.hold_measured(now)
        self._modes.new_epoch()
        text = f"{self._locked.sentence()}{', after a reset' if waits else ''}"
        self._answer(client, message.request, text)

    def receive_fault_played(self, event: FaultPlayed) -> None:
        if event.client not in self._clients.roles:
            return
        if event.played:
            self._answer(event.client, event.request, event.message)
        else:
            self._refuse(event.client, event.request, Refusal(Reason.NO_SUCH_FAULT, why=event.message))

    def _answer(self, client: ClientId, request: int, message: str) -> None:
        self._act(ToClient(client, program.Answer(request, message[:1_000])))

    def _refuse(self, client: ClientId, request: int, refusal: Refusal) -> None:
        self._act(ToClient(client, program.Answer(request, str(refusal), refusal.data)))


def barred(role: str, message: program.Down) -> str | None:
    """Returns why a client of a role may not send a request; None if it may."""
    if role == "operator" and not isinstance(message, OPERATORS):
        return "an operator may only stop the arm and read errors"
    if role == "commissioner" and not isinstance(message, COMMISSIONERS):
        return "a commissioner may only try actuators, cancel, stop and reset"
    if role == "planner" and isinstance(message, program.Trial):
        return "only a commissioner may try actuators"
    return None


def _switches(number: int) -> str:
    return "1 switch was" if number == 1 else f"{number} switches were"
