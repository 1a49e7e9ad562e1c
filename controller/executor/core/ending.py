"""The end of the executor: contracts the arm if `on_stop` says so, and warns of the boards' later behaviour."""

import logging

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.kinds import first
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.core.events import Act
from hyperbit.controller.executor.core.modes import Modes
from hyperbit.controller.executor.motion.motion import ArmMotion
from hyperbit.controller.executor.motion.program_execution import SetpointStream
from hyperbit.controller.host.process import Log, Notify
from hyperbit.controller.program import Setpoint, pack


class Ending:
    """Contracts the arm before the executor ends, with `on_stop: contract`; otherwise warns what the boards will do.

    `begun`: the end was requested. `timeout`: longest time of the contraction [s].
    """

    def __init__(self, arm: ExecutedArm, motion: ArmMotion, locked: LockedActuators, modes: Modes, act: Act) -> None:
        self.begun, self.timeout = False, 0.0
        self._arm, self._motion, self._locked, self._modes, self._act = arm, motion, locked, modes, act
        self._contracting = self._pulsing = False
        self._stream: SetpointStream | None = None  # contracts the arm; None before its start

    @property
    def over(self) -> bool:
        """Whether the executor may end: no stage, pulse or contraction is running."""
        return self.begun and not (self._contracting or self._motion.committing or self._pulsing)

    def _may_pulse(self, now: float) -> bool:
        """Returns whether a pulse is on, or a commit under way may begin one."""
        return self._motion.committing or self._motion.actuation.pulsing(now)

    def warning(self) -> str | None:
        """Returns a sentence on what the boards do after the executor has ended; None if they hold."""
        count = len(self._arm.wiring.contracting)
        if not count or self._arm.contract_on_stop:
            return None
        which = f"all {count} actuators" if count == len(self._arm.actuators) else f"{count} actuators"
        return f"when the executor has ended, the boards contract {which} (on_loss: contract)"

    def begin(self, now: float) -> None:
        """Starts the end: contracts the arm if `on_stop` says so and the mode is ready."""
        self.begun, self._pulsing = True, self._may_pulse(now)
        self._act(Notify("STOPPING=1"))
        warning, modes = self.warning(), self._modes
        if not self._arm.contract_on_stop:
            if warning is not None:
                self._act(Log(logging.WARNING, warning))
                modes.enter(modes.mode, f"the executor is shutting down; {warning}")
        elif not self._motion.kinds.believed:
            self._act(Log(logging.WARNING, "the arm does not contract before the end (on_stop): it is commissioned"))
        elif modes.mode != "ready":
            self._act(Log(logging.WARNING, f"the arm does not contract before the end (on_stop): it is {modes.mode}"))
        else:
            self._contracting, self.timeout = True, self._arm.ending
            self._act(Notify(f"EXTEND_TIMEOUT_USEC={round((self.timeout + 5) * 1e6)}"))
            self._contract()

    def advance(self, now: float) -> None:
        """Ends the contraction when the arm is contracted or cannot be. Call every period."""
        if not self.begun:
            return
        motion, modes, stream = self._motion, self._modes, self._stream
        self._pulsing = self._may_pulse(now)
        if not self._contracting:
            return
        if modes.mode not in ("ready", "executing") or (stream is not None and motion.stream is not stream):
            self.abandon()
        elif motion.busy:  # a commit that was under way at the request
            return
        elif stream is None or stream.start != motion.actuation.states:
            self._contract()
        elif not stream.stages and not motion.moving and now >= motion.actuation.free_at:
            self._contracting = False
            modes.hold("done", "", "contracted before the end of the executor")

    def abandon(self) -> None:
        if self._contracting:
            self._contracting = False
            modes = self._modes
            text = f"the arm is not contracted before the end (on_stop): it is {modes.mode}: {modes.reason}"
            self._act(Log(logging.WARNING, text))

    def _contract(self) -> None:
        """Starts to contract all actuators but the locked ones, as many at once as `inrush` permits.

        A commit under way ends first: until then the states are unknown.
        """
        if self._motion.busy:
            return
        states, size = self._motion.actuation.states, len(self._arm.actuators)
        stages, rest = list[bytes](), states & ~self._locked.mask
        while rest:
            rest &= ~first(rest, self._arm.most)
            stages.append(pack(rest | (states & self._locked.mask), size))
        reason = "contracting before the end of the executor"
        message = Setpoint(0, 0, pack(states, size), tuple(stages), 1e15, strict=False, reason=reason)
        stream = SetpointStream(message, self._arm.most, self._locked, size)
        if not stages and not self._motion.readings.homing:
            self._contracting = self._motion.moving  # a program may have contracted the last actuator just before
            return
        if not stages:  # only actuators of unknown state: homing them is enough
            stream.stages = [stream.start]
        self._modes.follow(stream)
        self._stream = self._motion.stream
