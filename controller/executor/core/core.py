"""The core of the executor: takes events and returns actions. It has no clock, no I/O and no threads."""

import logging
import math
import traceback
from collections.abc import Callable

from hyperbit.controller import program
from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core import events
from hyperbit.controller.executor.core.board_errors import BoardErrorRequests
from hyperbit.controller.executor.core.clients import Clients
from hyperbit.controller.executor.core.ending import Ending
from hyperbit.controller.executor.core.modes import CLEARING, Modes
from hyperbit.controller.executor.core.reports import Reports
from hyperbit.controller.executor.core.requests import ClientRequests
from hyperbit.controller.executor.motion.motion import ArmMotion
from hyperbit.controller.executor.motion.program_execution import ProgramResults
from hyperbit.controller.host.process import Log, Notify, Quit
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import FrameEchoed, FrameReceived

REST = 5  # most periods of TICK between two ticks at rest
CROWDED, AWAKE = 64, 1.0  # frames between two ticks that would fill a socket's buffer at rest; [s] without rest then
DEFECT = ArmFault("internal-error", "executor", "internal error, see the log; the arm holds")


class Executor:
    """Runs motion programs on the boards of an arm.

    Args:
        instance: random number that identifies this run.
        watchdog: systemd's watchdog time [s]; None: off.
        simulation: the simulated boards of this process; None: the boards are on CAN buses.
        build_master: returns the CANopen master; tests pass their own.
    """

    def __init__(
        self,
        arm: ExecutedArm,
        journal: SwitchJournal,
        instance: int,
        watchdog: float | None = None,
        simulation: program.PlayableFaults | None = None,
        build_master: Callable[..., Master] = Master,
    ) -> None:
        self.journal = journal
        self._arm, self._instance, self._watchdog, self._simulation = arm, instance, watchdog, simulation
        self._actions: list[events.Action] = []
        self.master = master = build_master(arm.wiring, arm.timing, self._send)
        self.clients = clients = Clients(arm.name, arm.planner_timeout, self._to_client)
        self._results = ProgramResults(clients.to_planner, journal)
        self.locked = locked = LockedActuators(arm.actuators, arm.locked, arm.locked_states)
        self.motion = motion = ArmMotion(arm, master, journal, locked, self._results, clients.to_planner)
        self.reports = Reports(arm, master, motion, locked, journal, simulation is not None)
        clearing = CLEARING | {"stuck"} if arm.continue_on_stuck else CLEARING
        self.modes = modes = Modes(master, motion, locked, clearing, self.reports, self._act, simulation is not None)
        self.requests = ClientRequests(arm, motion, locked, modes, self._act, clients)
        self.board_errors = BoardErrorRequests(arm.wiring, master, clients)
        self.ending = Ending(arm, motion, locked, modes, self._act)
        self._last_tick: float | None = None
        self._awake = 0.0  # awake time until the last tick [s]
        self.period = program.TICK  # until the next tick [s]
        self._frames, self._awake_until = 0, 0.0  # since the last tick; time until which too many frames forbid rest
        self._next_beat = 0.0
        self._healthy = True
        self._handed_out = False  # this step sends frames, so the snapshot comes with the next step

    @property
    def ended(self) -> bool:
        return self.ending.over

    @property
    def collecting(self) -> bool:
        """Whether the echo of an RPDO is awaited; the next echo may release the SYNC."""
        return self.master.switching.collecting

    @property
    def calm(self) -> bool:
        """Whether no commit and no procedure with a board is under way, so that the core can be pickled."""
        return self.master.calm and not self.motion.busy

    def resting(self, now: float) -> bool:
        """Returns whether nothing moves and nobody waits, so that frames may wait for the next tick."""
        asked = self.ending.begun or self.requests.held or self.board_errors.waiting
        rests = self.modes.mode in ("ready", "stopped", "fault") and not asked and now >= self._awake_until
        motion = self.motion
        return rests and motion.supervision.resting and motion.actuation.resting(now) and self.master.resting

    def step(self, event: events.Event, now: float) -> list[events.Action]:
        """Handles an event of a bus, a client or the loop; returns the actions in their order.

        An exception in one part of a step becomes the fault internal-error, and the arm holds. `now`: on
        CLOCK_MONOTONIC, or another clock that never goes back [s].
        """
        self._healthy, self._handed_out = True, False
        # A tick that is late by more than a period is no delay of an actuator.
        late = 0.0 if self._last_tick is None else min(now - self._last_tick, self.period + program.TICK)
        self.motion.clock = self._awake + late  # does not grow while a tick is late
        for part in (self._find_pause, self._handle, self._conclude, self._tell):
            try:
                part(event, now)
            except Exception:
                self._fail(traceback.format_exc(), now)
        actions, self._actions = self._actions, []
        return actions

    def check(self) -> None:
        """Asserts what must hold inside after each step. Tests call it; the robot never does."""
        mode, motion, clients = self.modes.mode, self.motion, self.clients
        motion.check()
        runs = motion.execution is not None or motion.stream is not None
        assert runs == (mode == "executing"), f"something runs: {runs}, in mode {mode}"
        assert bool(self.modes.faults) or mode != "fault", "mode fault without a fault"
        assert not self.modes.faults or mode not in ("ready", "executing"), f"{self.modes.faults} in mode {mode}"
        driver = None if clients.planner is None else clients.roles[clients.planner]
        assert driver in (None, "planner", "commissioner")
        assert motion.kinds.believed == (driver != "commissioner"), f"end-stops are believed beside a {driver}"
        assert motion.kinds.believed or motion.stream is None, "a set-point is followed while the arm is commissioned"
        assert not self.locked.states & ~self.locked.mask, "a state without a lock"

    def _fail(self, text: str, now: float) -> None:
        """Holds after a defect. The defect is logged once, not at each tick."""
        self._healthy = False
        self.modes.report(DEFECT, Log(logging.ERROR, f"internal error\n{text}"))
        self.modes.fail(DEFECT, now)

    def _find_pause(self, event: events.Event, now: float) -> None:
        """Tests first whether the process has paused: then the waiting events are stale."""
        if self._last_tick is not None and (fault := self.master.find_pause(now)) is not None:
            self.modes.fail(fault, now)

    def _handle(self, event: events.Event, now: float) -> None:
        match event:
            case events.ExecutorTick():
                self._tick(event, now)
            case events.FromClient():
                self._hear(event.client, event.message, now)
            case events.Health():
                self.reports.receive_health(event)
                self.clients.to_all(self.reports.diagnostics(now))
            case events.ClientGone():
                role = self.clients.roles.get(event.client)
                if self.clients.remove(event.client):
                    self.lose_planner(f"the {role} is gone")
                if role == "commissioner":
                    self.modes.believe(True, now)
            case events.FaultPlayed():
                self.requests.receive_fault_played(event)
            case events.Defect():
                self._fail(event.text, now)
            case Quit():
                self._quit(now)
            case _:
                self._frames += 1
                self.master.receive_event(event, now)

    def _conclude(self, event: events.Event, now: float) -> None:
        """Records what the event has changed on the boards."""
        at = None  # time of its frame on the bus [s]
        if isinstance(event, FrameEchoed | FrameReceived):
            if isinstance(event, FrameEchoed) and self.collecting:  # one echo of several; nothing has changed
                return
            # An SDO answer has no useful time: the end-stop changed before the question.
            if event.frame.id & 0x780 != cia301.SDO_ANSWER:
                at = now if event.at is None else min(event.at, now)
        self.modes.update(now)
        self.motion.conclude(at, now)
        if (fault := self.motion.actuation.fault) is not None:
            self.motion.actuation.fault = None
            self.modes.fail(fault, now)

    def _tell(self, event: events.Event, now: float) -> None:
        """Answers requests that waited, and publishes changes."""
        if self.requests.held:
            self.requests.answer_held(now)
        if self.reports.changed and self._last_tick is not None and not self._handed_out and not self.collecting:
            self._show(now)

    # --- time

    def _tick(self, event: events.ExecutorTick, now: float) -> None:
        if self._last_tick is None:
            self._act(Notify("READY=1"))
            self.modes.notify_status()
            if (warning := self.ending.warning()) is not None:
                self._act(Log(logging.WARNING, warning))
            self.modes.boot(self.modes.reason, now)
        self._awake, self._last_tick, self.period = self.motion.clock, now, program.TICK  # also after a defect
        self.master.tick(now)
        self._conclude(event, now)
        self.motion.actuation.tick(now)
        self.modes.update(now)  # a pulse that was missed may be a fault
        for fault in self.motion.actuation.find_overdue(now):
            self.modes.fail(fault, now)
        for actuator, fault in self.motion.supervision.tick(self.motion.clock, now):
            if fault.code == "stuck" and self._arm.continue_on_stuck:
                self.locked.stuck |= 1 << actuator
            self.modes.fail(fault, now)
        if self.board_errors.waiting:
            self.board_errors.answer()
        if (silent := self.clients.fell_silent(self.motion.clock)) is not None:
            self.lose_planner(f"the {silent} is silent")
        self._advance(now)
        self.ending.advance(now)
        self.modes.recover(now)
        if self.reports.snapshot_due(now):
            self._show(now)
        if self.reports.diagnostics_due(now):
            self.clients.to_all(self.reports.diagnostics(now))
        if self._watchdog and self._healthy and now >= self._next_beat:
            self._act(Notify("WATCHDOG=1"))
            self._next_beat = now + self._watchdog / 4
        self._plan_next(now)

    def _plan_next(self, now: float) -> None:
        """Plans the next tick: at rest the first one at which something is due, or after REST periods."""
        if self._frames > CROWDED:
            self._awake_until = now + AWAKE
        self._frames = 0
        if self.resting(now):
            due = min(
                self.reports.next_due(),
                self.master.heartbeat.next_due(),
                self._next_beat if self._watchdog else math.inf,
            )
            self.period *= min(max(math.ceil((due - now) / program.TICK - 0.01), 1), REST)
        self.master.rest(self.period)

    def _advance(self, now: float) -> None:
        if self.modes.mode == "executing" and (end := self.motion.advance(now)) is not None:
            self.modes.hold(*end)

    def _show(self, now: float) -> None:
        modes = self.modes
        self.clients.to_all(
            self.reports.snapshot(now, modes.mode, modes.reason, modes.epoch, tuple(modes.faults.values()))
        )

    # --- clients

    def _hear(self, client: events.ClientId, message: program.Down, now: float) -> None:
        if client == self.clients.planner:
            self.clients.hear(self.motion.clock)
        match message:
            case program.Hello():
                if not self.clients.greet(client, message, self.motion.clock):
                    return
                arm, counts, greatest = self._arm, tuple(self.journal.counts), self.requests.greatest
                known = arm.name, arm.digest, self._instance, counts, greatest, self._simulation
                self._to_client(client, program.Welcome(*known))
                if message.role != "operator":
                    self._results.send_again()
                if message.role == "commissioner":
                    self.modes.believe(False, now)
                self.reports.changed = True
            case _ if client not in self.clients.roles:
                self._to_client(client, program.Goodbye("Hello must be the first message"))
            case program.Acknowledge() if client == self.clients.planner:
                self._results.stored.pop(message.result, None)
            case program.Counts() if client == self.clients.planner:
                self.journal.raise_to(message.counts)
            case program.ReadErrors():
                self.board_errors.receive(client, message)
            case _:
                self.requests.receive_request(client, message, now)
                self._advance(now)  # a stage that is due now does not wait for the tick

    def lose_planner(self, why: str) -> None:
        """Ends the planner's motion, and begins an epoch: the socket may hold requests planned before.

        At the end of the executor none of the planner's motion runs any more.
        """
        self.modes.new_epoch()
        if not self.ending.begun:
            self.modes.hold("aborted", f"{why}; the arm holds", f"holding; {why}")

    def _quit(self, now: float) -> None:
        """Ends the running program with a result; a second call waits for no stage and no contraction."""
        if self.ending.begun:
            self.ending.abandon()
            self.motion.send_result()
            self._results.send_counts()
            self.requests.answer_held(math.inf)
            return
        self.requests.quitting = True
        why = "the executor is shutting down"
        self.modes.hold("aborted", f"{why}; the arm holds", f"holding; {why}")
        self.ending.begin(now)

    # --- actions

    def _act(self, action: events.Action) -> None:
        self._actions.append(action)

    def _send(self, bus: str, frame: Frame) -> None:
        self._actions.append(events.SendFrame(bus, frame))
        self._handed_out = True

    def _to_client(self, client: events.ClientId, message: program.Up) -> None:
        self._actions.append(events.ToClient(client, message))
