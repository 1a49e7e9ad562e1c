"""Snapshots 20 times a second and on each change, and diagnostics once a second."""

from dataclasses import asdict

from hyperbit.controller.armfile.names import shortened
from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.kinds import indices
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.events import Health
from hyperbit.controller.executor.motion.motion import ArmMotion
from hyperbit.controller.messages.state import Board, Bus, LoopTimes, WorstCase
from hyperbit.controller.program import Diagnostics, Fault, Mode, Snapshot, pack
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wiring import next_due

SNAPSHOT_EVERY, DIAGNOSTICS_EVERY = 0.05, 1.0  # [s]
MOST_FAULTS, MOST_TEXT = 50, 300  # faults, and characters of each, so that a snapshot fits one message
END_FROM = 100  # characters before the cut of a longer text


def cut(text: str) -> str:
    """Cuts words out of the middle of a long text: the beginning says what is wrong and where, the end what to do."""
    if len(text) <= MOST_TEXT:
        return text
    head, tail = text[:END_FROM], text[END_FROM + 3 - MOST_TEXT :]
    return f"{head.rpartition(' ')[0] or head} … {tail.partition(' ')[2] or tail}"


class Reports:
    """Makes snapshots and diagnostics when they are due. `changed`: the state differs from the last snapshot."""

    def __init__(
        self,
        arm: ExecutedArm,
        master: Master,
        motion: ArmMotion,
        locked: LockedActuators,
        journal: SwitchJournal,
        simulated: bool,
    ) -> None:
        self.changed = True
        self.real_time = "off"
        self._health = Health(LoopTimes(), 0, None)
        self._arm, self._master, self._motion, self._locked, self._journal = arm, master, motion, locked, journal
        self._size, self._simulated = len(arm.actuators), simulated
        self._next_snapshot = self._next_diagnostics = 0.0
        self._shown: tuple[int, ...] = ()

    def next_due(self) -> float:
        """Returns when the next snapshot or diagnostics are due by time [s]."""
        return min(self._next_snapshot, self._next_diagnostics)

    def snapshot_due(self, now: float) -> bool:
        """Returns whether a snapshot is due at this tick: by time, or because the state has changed."""
        motion = self._motion
        shown = (motion.actuation.states, motion.readings.measured, motion.readings.known, int(motion.moving))
        self.changed |= shown != self._shown
        self._shown = shown
        return self.changed or now >= self._next_snapshot

    def snapshot(self, now: float, mode: Mode, reason: str, epoch: int, faults: tuple[ArmFault, ...]) -> Snapshot:
        due = self._next_snapshot if now >= self._next_snapshot else now
        self.changed, self._next_snapshot = False, next_due(due, SNAPSHOT_EVERY, now)
        motion, size = self._motion, self._size
        execution, stream = motion.execution, motion.stream
        measured, known = motion.readings.packed()
        problem, homing = self._health.journal, motion.readings.homing & self._master.inputs.known
        own = () if problem is None else (ArmFault("journal", "executor", problem),)
        every = faults + self._locked.faults() + self._master.warnings() + own
        if homing:
            labels, count = shortened([self._arm.actuators[k] for k in indices(homing)]), homing.bit_count()
            them = (
                "1 actuator first, with 1 switch" if count == 1 else f"{count} actuators first, with {count} switches"
            )
            text = f"the position of {labels} is unknown: the next goal homes {them}; or use `jog`"
            every += (ArmFault("unknown-position", "arm", text),)
        if self._arm.uncommissioned is not None and not self._simulated:
            every += (ArmFault("not-commissioned", "arm", self._arm.uncommissioned),)
        return Snapshot(
            at=now,
            mode=mode,
            reason=reason[:1_000],
            epoch=epoch,
            outputs=pack(motion.actuation.states, size),
            measured=measured,
            known=known,
            sensed=pack(motion.kinds.sensed, size),
            homing=pack(homing, size),
            unread=pack(motion.actuation.unproven, size),
            locked=pack(self._locked.mask, size),
            moving=motion.moving,
            free_at=motion.actuation.free_at,
            program=-1 if execution is None else execution.program.program,
            stream=-1 if stream is None else stream.number,
            faults=tuple(Fault(fault.code, fault.source[:100], cut(fault.message)) for fault in every[:MOST_FAULTS]),
        )

    def receive_health(self, health: Health) -> None:
        self.changed |= health.journal != self._health.journal
        self._health = health

    def diagnostics_due(self, now: float) -> bool:
        return now >= self._next_diagnostics

    def diagnostics(self, now: float) -> Diagnostics:
        self._next_diagnostics = next_due(self._next_diagnostics, DIAGNOSTICS_EVERY, now)
        status = self._master.status()
        return Diagnostics(
            at=now,
            loop=self._health.loop,
            buses=[Bus(**{**asdict(it), "worst_case": WorstCase(**asdict(it.worst_case))}) for it in status.buses],
            boards=[Board(**asdict(it)) for it in status.boards],
            real_time=self.real_time[:1_000],
            counts=tuple(self._journal.counts),
            waits=self._motion.clearances.waits,
            dropped=self._health.dropped,
        )
