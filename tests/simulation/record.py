"""The history of the world for the invariants, as seen at the executor's boards and clients."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable

from controller.executor.core.arm import ExecutedArm
from controller.executor.core.core import LONGEST_TICK, Executor
from controller.executor.core.events import ClientGone, Event, ExecutorTick, FromClient
from controller.executor.motion.program_execution import STARVED
from controller.planning.core.goals import MOVED
from controller.program import (
    TICK,
    Accepted,
    Acknowledge,
    Answer,
    Begun,
    Cancel,
    Declined,
    Ended,
    Hello,
    Program,
    Replaced,
    Replacement,
    Reset,
    Setpoint,
    Settled,
    Snapshot,
    Stop,
    Up,
    unpack,
)
from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import Frame
from tests.simulation.agenda import Agenda
from tests.simulation.buses.bus_model import RPDOS
from tests.simulation.executor.process import Witness
from tests.simulation.facts import Commit, Energised, Running, Step, Switch

MASTER_HEARTBEAT = cia301.HEARTBEAT + 127
LATE = 1e-6  # [s], rounding error


class Record(Witness):
    """The history of a world.

    Attributes:
        step: facts of the present step.
        programs: accepted programs, by instance of the executor and number.
        results: number of the result of each program.
        acknowledged: acknowledged results, by instance and number.
        synced: number of switches of each actuator by SYNCs.
        slack: permitted difference between the journal and `synced`, after a lost frame or an unread board.
        lying: mask of the actuators with frozen end-stops or broken wires.
        fallen: mask of the actuators whose outputs changed without a SYNC, perhaps unknown to the executor.
        floor: number of cancels, halts, faults and lost planners of this instance, the least value of its epoch.
        barred: the epoch shown when the planner was lost last, or when it was heard last before its silence.
        suspect: mask of the actuators whose boards have missed a frame since their boot.
        last_heartbeat: time of the executor's last heartbeat on each bus [s].
        disturbed_at: last time when its heartbeats could not be sent on each bus [s].
        switched_at: time when a SYNC switched each actuator [s].
        energised_at: time when one of two coils of each actuator came on [s]; None: both are off.
        away: time since then in which the executor could not reach the board of each actuator [s].
        looked_at: time up to which `away` is counted [s].
        unreached: whether the executor could not reach the board of each actuator at that time.
        stopped_at: time of the answer to a halt or cancel [s]; infinity after a later request to move.
        open_since: time when an interlock was opened [s]; infinity if all are closed.
        declined_in_switch: whether a switch was under way when a program was declined last because the arm moved.
        unread_at: last time when the board of the interlock did not send its inputs [s].
        core: returns the executor, for its uncertain states and pulses.
    """

    def __init__(self, arm: ExecutedArm, agenda: Agenda, note: Callable[[object], None]) -> None:
        count = len(arm.actuators)
        self.step = Step()
        self.counts: Counter[str] = Counter()
        self.mode, self.epoch, self.locked, self.instance = "starting", 0, arm.locked, 0
        self.locked_states, self._outputs, self._locks = arm.locked_states, 0, -1
        self.running: Running | None = None
        self.commit: Commit | None = None
        self.last_commit: tuple[Commit, float] | None = None  # that switched anything, and when
        self.last_after = 0  # outputs after it
        self.programs: dict[tuple[int, int], Program] = {}
        self.results: dict[tuple[int, int], int] = {}
        self.acknowledged: set[tuple[int, int]] = set()
        self.synced, self.slack = [0] * count, [0] * count
        self.suspect = self.fallen = 0
        self.lying = self._lied = 0
        self.floor = self.barred = 0
        self._heard_epoch, self._silence, self._silent = 0, 0.0, False
        self._last_tick = agenda.now
        self.last_heartbeat = {bus.name: agenda.now for bus in arm.wiring.buses}
        self.disturbed_at = dict(self.last_heartbeat)
        self.switched_at = [-1e12] * count
        self.energised_at: list[float | None] = [None] * count
        self.away, self.looked_at, self.unreached = [0.0] * count, [0.0] * count, [False] * count
        self.stopped_at, self._epoch_at_stop = math.inf, 0
        self.open_since, self.unread_at = math.inf, agenda.now
        self.declined_in_switch = False
        self.core: Callable[[], Executor | None] = lambda: None
        self._arm, self._agenda, self._note = arm, agenda, note
        self._bus_of = [channel.bus for channel in arm.wiring.channels]
        self._setpoints: deque[Setpoint] = deque(maxlen=3)
        self._message: object = None
        self._stops = False  # whether the message stops what runs

    # --- the executor

    def started(self) -> None:
        """Records the start of an executor."""
        self._note("the executor starts")
        self.instance += 1
        self.mode, self.epoch, self.floor, self.commit = "starting", 0, 0, None
        self._epoch_at_stop = self.barred = self._heard_epoch = 0
        self.locked = self._arm.locked
        self._hold()

    def killed(self) -> None:
        """Records the end of an executor."""
        self._note("the executor is dead")
        self.counts["executors that ended"] += 1
        self._hold()

    def told(self, event: Event) -> None:
        """Records an event that the executor takes."""
        self._note(("executor takes", event))
        self._stops = False
        self._watch_planner(event)
        message = self._message = event.message if isinstance(event, FromClient) else None
        match message:
            case Acknowledge():
                self.acknowledged.add((self.instance, message.result))
            case Cancel(program=None) | Stop():
                self._stops = True
                self._hold()
            case Cancel() if self.running is not None and self.running.number == message.program:
                self._stops = True
                self._hold()
            case Reset() if self.mode in ("fault", "stopped"):
                self._hold()
            case Setpoint() if message.epoch == self.epoch:
                self._setpoints.append(message)
                if message.epoch > self._epoch_at_stop:
                    self.stopped_at = math.inf

    def says(self, message: Up) -> None:
        """Records a message to a client."""
        self._note(("executor says", message))
        self.counts[type(message).__name__] += 1
        match message:
            case Accepted():
                self._accept(message)
            case Declined(refused=refused) if refused.reason in MOVED and (core := self.core()) is not None:
                self.declined_in_switch = core.motion.busy
            case Answer() if isinstance(self._message, Stop | Cancel):
                self.floor += getattr(self._message, "program", None) is None
                if self._stops:
                    of_one = isinstance(self._message, Cancel) and self._message.program is not None
                    # The cancel of one program begins no epoch: set-points of this epoch may follow.
                    self.stopped_at, self._epoch_at_stop = self._agenda.now, self.epoch - of_one
            case Replaced(accepted=True) if isinstance(self._message, Replacement) and self.running is not None:
                self.counts["parked"] += not self._message.stages
                self.running.replace(self._message)
            case Begun() | Settled() if self.running is not None and self.running.number == message.program:
                self.step.progress.append((message, self.running))
            case Ended():
                self.counts["starved"] += STARVED in message.message
                still = self.running is not None and self.running.number == message.program
                self.step.ended.append((message, self.running if still else None))
                self.counts[message.status] += 1
                if self.running is not None and self.running.number == message.program:
                    self.running = None
            case Snapshot():
                self._show(message)

    def logs(self, level: int, text: str) -> None:
        """Records a log line of the executor."""
        self._note(("executor logs", text))
        if "internal error" in text:
            self.step.errors.append(text)

    def sends(self, bus: str, frame: Frame) -> Commit | None:
        """Records a frame that the executor hands out; returns the commit of a SYNC."""
        self.step.frames.append((bus, frame))
        executor = self.core()
        self.step.booting |= executor is None or executor._master.booting
        now = self._agenda.now
        if frame.id == cia301.SYNC:
            if self.commit is not None:
                self.commit.synced_at = now
            return self.commit
        elif frame.id & 0x780 in RPDOS and (self.commit is None or self.commit.began != now):  # all are sent at once
            apart = bool((self._outputs ^ self.locked_states) & self.locked)
            core = self.core()
            assert core is not None
            contracting = core.ending.begun and core.modes.mode == "executing"
            if contracting:
                self.stopped_at = math.inf
            asked = self.running is not None or bool(self._followed(now)) or contracting
            candidates = [(-1, self._outputs & self.locked)] if contracting else self._asked(now)
            self.commit = Commit(now, self.locked, self.locked_states, apart and asked, self.running, candidates)
            if asked:
                execution, states = core.motion.execution, core.motion.actuation.states
                homed, self.commit.homes = (-1, states) if execution is None else execution.homed
                self.commit.homing = core.motion.readings.homing & homed
            self.commit.releases = any(core.motion.kinds.on(core._master.outputs))
        return None

    # --- the boards

    def arrives(self, bus: str, frame: Frame, missing: int) -> None:
        """Records a sent frame of the executor; the boards of a mask of actuators do not receive it."""
        self._note(("boards hear", bus, frame, f"not those of {missing:b}" if missing else ""))
        if frame.id == MASTER_HEARTBEAT:
            self.last_heartbeat[bus] = self._agenda.now
        if frame.id == cia301.SYNC or frame.id & 0x780 in RPDOS:
            self.suspect |= missing
        if frame.id == cia301.SYNC:
            for k in range(len(self.slack)):
                self.slack[k] += self.suspect >> k & 1

    def switch(self, switch: Switch) -> None:
        """Records changed outputs."""
        self._note((f"{switch.mask:b} switched to {switch.after:b}", switch.cause))
        self.step.switches.append(switch)
        for k in range(len(self.synced)):
            self.synced[k] += switch.cause == "SYNC" and switch.mask >> k & 1
            if switch.commit is not None and switch.cause == "SYNC":  # the executor had guessed otherwise, if at all
                self.slack[k] += (switch.mask & switch.commit.homing) >> k & 1
        self.fallen |= switch.mask * (switch.cause != "SYNC")
        if switch.cause == "SYNC" and switch.commit is not None:
            self.counts["realigned"] += (switch.mask & switch.commit.locked).bit_count()
        self.counts["switches"] += switch.mask.bit_count() * (switch.cause == "SYNC")

    def energise(self, coils: Energised) -> None:
        """Records coils that came on or went off."""
        if coils.came:
            self.step.energised.append(coils)
        for k, since in enumerate(self.energised_at):
            # The end-stop of one that did not follow its coil told the other state: for the executor it switches.
            self.slack[k] += coils.again >> k & 1
            if coils.came >> k & 1:
                self.energised_at[k] = self.looked_at[k] = self._agenda.now
                self.away[k], self.unreached[k] = 0.0, False
            elif since is not None and coils.bus == self._bus_of[k] and not coils.on >> k & 1:
                self.energised_at[k] = None

    def doors(self, are_open: bool) -> None:
        """Records whether an interlock is open."""
        self.open_since = min(self.open_since, self._agenda.now) if are_open else math.inf

    def doubt(self, intended: int) -> None:
        """Permits a difference of the counts where nobody can tell whether an intended switch took place.

        This is so for outputs that went off unnoticed, and for pairs that are off with broken wires of end-stops.
        """
        lied = intended & self.lying
        for k in range(len(self.slack)):
            self.slack[k] += ((self.fallen & intended) | (lied & ~self._lied)) >> k & 1
        self.fallen &= ~intended
        self._lied = lied

    # ---

    def _hold(self) -> None:
        self.running = None
        self._setpoints.clear()

    def _watch_planner(self, event: Event) -> None:
        """Records the time for which the planner was silent and a program waits, and the loss of the planner."""
        core, now = self.core(), self._agenda.now
        assert core is not None
        planner = core._clients.planner
        match event:
            case ExecutorTick():
                passed = min(now - self._last_tick, LONGEST_TICK)
                self._last_tick = now
                self._silence += passed
                if self.running is not None and self.running.starves:
                    self.running.unfed += passed
                lost = not self._silent and self._silence > self._arm.planner_timeout + 3 * TICK
                if planner is not None and lost:
                    self._silent = True
                    self._lose_planner(self._heard_epoch)
            case ClientGone() if event.client == planner:
                self._lose_planner(self.epoch)
            case FromClient() if event.client == planner or isinstance(event.message, Hello):
                self._heard_epoch, self._silence, self._silent = self.epoch, 0.0, False

    def _lose_planner(self, epoch: int) -> None:
        """Records that requests of an epoch and of those before are barred."""
        self.counts["lost planners"] += 1
        self.floor, self.barred = self.floor + 1, max(self.barred, epoch)
        self._hold()

    def _accept(self, message: Accepted) -> None:
        program = self._message
        assert isinstance(program, Program), "only a program is accepted"
        assert all(n < program.program for instance, n in self.programs if instance == self.instance), "numbers grow"
        self._hold()
        stages = [(unpack(stage.states), stage.at) for stage in program.stages]
        marks = [stage.mark for stage in program.stages]
        self.stopped_at = math.inf
        self.running = Running(program.program, message.begin, program.strict, program.final, stages, marks)
        self.programs[self.instance, program.program] = program
        self.step.accepted.append((program, message))
        self.counts["strict"] += program.strict

    def _show(self, snapshot: Snapshot) -> None:
        if self.mode == "starting" and snapshot.mode == "ready":
            self.suspect = self.fallen = 0  # the outputs were read back
        if snapshot.mode == "fault" != self.mode:
            self.counts["fault"] += 1
            self.floor += 1
        self.step.epochs.append((snapshot.epoch, self.floor))
        if snapshot.locks != self._locks or (snapshot.mode == "ready" and self.mode not in ("ready", "executing")):
            self._locks, self.locked_states = snapshot.locks, unpack(snapshot.measured) & unpack(snapshot.locked)
        self._outputs = unpack(snapshot.outputs)
        self.mode, self.epoch, self.locked = snapshot.mode, snapshot.epoch, unpack(snapshot.locked)
        if self.mode not in ("ready", "executing"):
            self._hold()

    def _asked(self, now: float) -> list[tuple[int, int]]:
        """Returns index and states of the stages that may begin now."""
        if self.running is not None:
            due = enumerate(self.running.stages)
            return [
                (k, states)
                for k, (states, at) in due
                if k > self.running.last and self.running.begin + at <= now + LATE
            ]
        return [(-1, states) for states in self._followed(now)]

    def _followed(self, now: float) -> list[int]:
        """Returns the stages of the followed set-points."""
        if not self._setpoints or self._setpoints[-1].until < now - LATE:
            return []
        return [unpack(states) for setpoint in self._setpoints for states in setpoint.stages]
