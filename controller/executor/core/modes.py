"""The modes of the executor: starting, ready, executing, fault, stopped; and the active faults."""

import logging

from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.core.events import Act
from hyperbit.controller.executor.core.reports import Reports
from hyperbit.controller.executor.motion.motion import ArmMotion
from hyperbit.controller.executor.motion.program_execution import ProgramExecution, SetpointStream
from hyperbit.controller.host.journal import fields_of_fault, fields_of_mode
from hyperbit.controller.host.process import Log, Notify
from hyperbit.controller.program import Mode
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.master import Master

RETRY = 1.0  # [s] before each attempt to leave a fault that clears by itself
# Codes of faults that clear by themselves; `continue_on_stuck` adds one.
CLEARING = frozenset({"bus-down", "bus-off", "bus-busy", "board-lost", "board-missing", "pulse-overdue"})


class Modes:
    def __init__(
        self,
        master: Master,
        motion: ArmMotion,
        locked: LockedActuators,
        clearing: frozenset[str],
        reports: Reports,
        act: Act,
        simulated: bool,
    ) -> None:
        self.mode: Mode = "starting"
        self.reason = "the boards are being booted"  # a sentence on the mode
        # grows with each cancel, stop, reset, fault, change of the locked actuators, end of a boot, and loss of the
        # planner
        self.epoch = 1
        # active faults by code and source, in the order of their reports
        self.faults: dict[tuple[str, str], ArmFault] = {}
        self._master, self._motion, self._locked, self._reports, self._act = master, motion, locked, reports, act
        self._clearing, self.simulated = clearing, simulated
        self._booting = self._waits = False  # a boot is under way, or waits for the end of a pulse
        self._settles = 0.0  # time before which no boot begins [s]
        self._next_try = 0.0

    def enter(self, mode: Mode, reason: str) -> None:
        """Enters a mode, and reports it to the log and to systemd."""
        changed = (mode, reason) != (self.mode, self.reason)
        self.mode, self.reason, self._reports.changed = mode, reason, True
        if changed:
            level = logging.WARNING if mode in ("fault", "stopped") else logging.INFO
            self._act(Log(level, f"{mode}: {reason}", fields_of_mode(mode)))
            self.notify_status()

    def notify_status(self) -> None:
        self._act(Notify(f"STATUS={self.mode}{' (simulated)' * self.simulated}: {self.reason}"))

    def hold(self, status: str, message: str, reason: str, mode: Mode = "ready") -> None:
        """Ends motion, gives up waiting frames, and enters a mode. Every end of a motion uses this method.

        Boards keep what they have latched, and the next commit replaces it before its SYNC. Frames under way that
        switch, `Actuation.under_way`, cannot be given up.

        `status` and `message` are those of the result of a program. Mode "ready" is entered from "executing" only,
        since the arm holds in the other modes.
        """
        self._motion.actuation.give_up(message or "the arm holds")
        self._motion.end(status, message)
        if mode != "ready" or self.mode == "executing":
            self.enter(mode, reason)

    def run(self, execution: ProgramExecution) -> None:
        """Starts a program in place of the present motion. Every program begins here."""
        self._motion.run(execution)
        self.enter("executing", execution.program.name)

    def follow(self, stream: SetpointStream) -> None:
        """Follows a set-point in place of the present motion. Every set-point begins here."""
        self._motion.follow(stream)
        if (self.mode, self.reason) != ("executing", stream.reason):
            self.enter("executing", stream.reason)

    def new_epoch(self) -> None:
        """Begins an epoch: programs and streams of earlier epochs are refused, so the planner must plan again."""
        self.epoch += 1
        self._reports.changed = True

    def boot(self, reason: str, now: float) -> None:
        """Boots the boards; `update` finds the end of the boot."""
        self.faults.clear()
        self._booting = self._waits = True
        self._motion.supervision.reset(0, 0, self._motion.clock)
        self.enter("starting", reason)
        self._begin_boot(now)

    def believe(self, ends: bool, now: float) -> None:
        """Believes the end-stops, or none of them while the arm is commissioned; the boards boot, nothing moves.

        An actuator that was switched without belief travels to its end first. After a stop or a fault, Reset boots.
        """
        motion = self._motion
        self._settles = motion.actuation.free_at
        motion.kinds.believe(ends)
        self._master.outputs.believe(ends)
        motion.supervision.reset(0, 0, motion.clock)
        if self.mode in ("ready", "starting"):
            self.boot(f"the boards are being booted {'after' if ends else 'for'} a commission", now)

    def update(self, now: float) -> None:
        """Reads the master's faults, and detects the end of a boot. Call after each event."""
        for fault in self._master.faults.drain():
            self.fail(fault, now)
        if self._waits:
            self._begin_boot(now)
        if self._booting and not self._waits and not self._master.booting.under_way:
            self._booting = False
            if self.mode == "starting":  # after a stop, only Reset boots
                self._booted(now)
        if self._motion.kinds.interlocks and not self._booting:
            for fault in self._motion.readings.interlock_faults():
                self.fail(fault, now)

    def fail(self, fault: ArmFault, now: float) -> None:
        """Ends the program and enters mode fault. During a boot, the end of the boot enters it."""
        self.report(fault)
        if self.mode in ("ready", "executing") or (self.mode == "starting" and not self._booting):
            self._enter_fault(fault.message, fault.message, now)
        else:
            self.hold("aborted", fault.message, self.reason, self.mode)

    def report(self, fault: ArmFault, line: Log | None = None) -> None:
        """Adds a fault, and logs a new one; `line` replaces the log text."""
        key = fault.code, fault.source
        if key not in self.faults:
            self.faults[key] = fault
            self._act(line or log_line(logging.ERROR, fault))

    def recover(self, now: float) -> None:
        """Leaves mode fault without a Reset if every fault clears by itself and all boards are heard again."""
        if self.mode != "fault" or now < self._next_try or not all(code in self._clearing for code, _ in self.faults):
            return
        self._next_try = now + RETRY
        self._master.probe_silent(now)
        if self._master.back and not self._motion.moving:
            self.boot("the boards are back and are being booted", now)

    def hold_measured(self, now: float) -> None:
        self._locked.lock_as_measured(self._motion.readings.read, self._motion.readings.definite)
        self._motion.adopt(now)
        self._motion.supervision.accept(self._motion.readings.measured, self._master.inputs.known)
        self.new_epoch()
        locked = f", {self._locked.sentence()}" if self._locked.mask else ""
        self.enter("ready", f"holding what the boards measured{locked}")

    def _begin_boot(self, now: float) -> None:
        """Starts the master's boot when no switch is under way and no pulse is on: the boot would delay its end."""
        actuation = self._motion.actuation
        if not actuation.pulsing(now) and not actuation.under_way and now >= self._settles:
            self._waits = False
            actuation.told = 0  # overdue pulses are reported again: the boot may fail before the next period
            self._master.boot(now)

    def _booted(self, now: float) -> None:
        for fault in (*self._master.booting.faults, *self._motion.readings.interlock_faults()):
            self.report(fault)
        for warning in self._master.warnings():
            self._act(log_line(logging.WARNING, warning))
        if self.faults:
            oldest, *others = self.faults.values()
            self._enter_fault("", oldest.message + (f" (and {len(others)} more)" if others else ""), now)
        else:
            motion = self._motion
            motion.adopt(now)
            motion.supervision.reset(motion.readings.measured, self._master.inputs.known, motion.clock)
            self.hold_measured(now)

    def _enter_fault(self, message: str, reason: str, now: float) -> None:
        self.new_epoch()
        self._next_try = now + RETRY
        self.hold("aborted", message, reason, "fault")


def log_line(level: int, fault: ArmFault) -> Log:
    return Log(level, f"{fault.code}: {fault.message}", fields_of_fault(fault.code, fault.source))
