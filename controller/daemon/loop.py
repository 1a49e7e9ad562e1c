"""The control loop: the one writer of the arm's state and of the bus, and the daemon's modes."""

import logging
import queue
import threading
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from controller.daemon.events import Cancel, Event, Payload, Planned, Quit, Reply, Reset, Started, Stop
from controller.daemon.execution import Execution
from controller.daemon.ledger import Ledger
from controller.daemon.notify import Notifier
from controller.daemon.state import Diagnostics, Mode, Snapshot, measured_tip, pose, written
from controller.daemon.timekeeping import Timekeeper
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion import codes
from drivers.boards import Boards
from drivers.faults import BusBusy, Fault

log = logging.getLogger(__name__)

PERIOD = 0.01  # [s]
STATE_EVERY = 0.05
DIAGNOSTICS_EVERY = 1.0
BUSY_FOR = 0.25  # a bus that takes no frame for this long is a fault


class Telemetry(Protocol):
    """Where snapshots go; must not wait."""

    def show(self, snapshot: Snapshot) -> None:
        """Takes the latest state."""

    def diagnose(self, diagnostics: Diagnostics) -> None:
        """Takes the latest diagnostics."""


class ControlLoop:
    """Owns boards and modes. Other threads only put events into `inbox`, and read `commanded` and `mode`.

    Args:
        manipulator: the arm.
        boards: connected; the loop subscribes to their faults.
        travel: longest time of an actuator from end-stop to end-stop [s].
        publish: sends a payload on "feedback" or "result"; must not wait.
        telemetry: takes snapshots.
        ledger: counts switches and goals.
        notifier: word to systemd.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        boards: Boards,
        travel: float,
        publish: Callable[[str, Payload], None],
        telemetry: Telemetry,
        ledger: Ledger,
        notifier: Notifier,
    ) -> None:
        self.inbox: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self.mode: Mode = "starting"
        self.reason = "the boards are being brought up"
        self.commanded: Configuration | None = None
        self._manipulator, self._boards, self._travel = manipulator, boards, travel
        self._publish, self._telemetry, self._ledger, self._notifier = publish, telemetry, ledger, notifier
        self._execution: Execution | None = None
        self._faults: dict[tuple[str, str], Fault] = {}
        self._states: NDArray[np.uint8] | None = None
        self._accept_after = 0
        self._accepted = 0
        self._switches = 0
        self._busy_since: float | None = None
        self._changed = True
        self._quitting = False
        self._next_state = self._next_diagnostics = self._next_beat = 0.0
        self._time = Timekeeper(PERIOD)
        boards.subscribe(self.inbox.put)

    # --- the loop

    def run(self) -> None:
        """Runs until Quit is handed over; ends with the arm holding and every goal told its result."""
        self._bring_up()
        self._notifier.send("READY=1", f"STATUS={self.mode}: {self.reason}")
        self._time.start(time.monotonic())
        while not self._quitting:
            try:
                self._handle(self.inbox.get(timeout=self._time.left(time.monotonic())))
            except queue.Empty:
                pass
            except Exception:  # a defect must not let go of the arm: hold, and say so
                log.exception("internal error")
                self._fail(Fault("internal-error", "daemon", "internal error, see the journal; the arm holds"))
            if self._time.left(time.monotonic()) <= 0:
                began = time.monotonic()
                try:
                    self._tick(began)
                except Exception:
                    log.exception("internal error")
                    self._fail(Fault("internal-error", "daemon", "internal error, see the journal; the arm holds"))
                self._time.ticked(began, time.monotonic())
        self._notifier.send("STOPPING=1")
        self._end_goal("aborted", codes.PATH_TOLERANCE_VIOLATED, "the daemon is shutting down; the arm holds")
        self._show(time.monotonic())

    def _tick(self, now: float) -> None:
        self._boards.tick(now)
        if self._execution is not None:
            self._execute(self._execution, now)
        if self._notifier.watchdog and now >= self._next_beat:
            self._notifier.send("WATCHDOG=1")
            self._next_beat = now + self._notifier.watchdog / 4
        if self._changed or now >= self._next_state:
            self._show(now)
        if now >= self._next_diagnostics:
            self._next_diagnostics = now + DIAGNOSTICS_EVERY
            status = self._time.take()
            waiting, ledger = self.inbox.qsize(), self._ledger.fault
            self._telemetry.diagnose(
                Diagnostics(time.time(), status, self._boards.status(), waiting, self._switches, ledger)
            )

    def _handle(self, event: Event) -> None:
        match event:
            case Planned():
                self._take(event)
            case Cancel():
                self._accept_after = event.arrival
                told = self._end_goal("canceled", codes.INVALID_GOAL, "canceled; the arm holds")
                if self.mode == "executing":
                    self._enter("ready", "holding; the goal was canceled")
                event.reply(answer("canceled" if told else "there was no goal to cancel; the arm holds"))
            case Stop():
                self._accept_after = event.arrival
                self._end_goal("aborted", codes.PATH_TOLERANCE_VIOLATED, "emergency stop; the arm holds")
                self._enter("stopped", "emergency stop; the arm holds until reset")
                event.reply(answer("stopped; the arm holds until reset"))
            case Reset():
                self._reset(event.reply)
            case Started():
                self._started(event.faults)
            case Fault():
                self._fail(event)
            case Quit():
                self._quitting = True

    # --- goals

    def _take(self, goal: Planned) -> None:
        refusal = None
        if goal.arrival <= self._accept_after:
            refusal = "canceled, stopped or reset before it began"
        elif self.mode not in ("ready", "executing"):
            refusal = f"the arm is {self.mode}: {self.reason}"
        if refusal is not None:
            goal.reply({"accepted": False, "id": goal.id, "code": codes.INVALID_GOAL, "message": refusal})
            return
        self._end_goal("replaced", codes.INVALID_GOAL, f"replaced by goal {goal.id}")
        now = time.monotonic()
        self._execution = Execution(goal, offset=now - time.time(), lead=self._travel + PERIOD)
        self._accepted += 1
        self._ledger.accepted(self._accepted, goal.id, len(goal.plan.solutions))
        self._enter("executing", f"goal {goal.id}")
        message = f"accepted, {len(goal.plan.solutions)} waypoints, {goal.plan.switches} switches planned"
        goal.reply({"accepted": True, "id": goal.id, "code": codes.SUCCESSFUL, "message": message})
        self._execute(self._execution, now)

    def _execute(self, execution: Execution, now: float) -> None:
        if execution.reported < execution.waypoint and now >= execution.settled_at and not self._boards.moving(now):
            self._arrived(execution)
            if execution.last:
                self._finish(execution)
                return
        waypoint = execution.due(now)
        if waypoint is not None and self._commit(execution.plan.actuator_states[waypoint], now):
            before = self.commanded
            self.commanded = execution.plan.solutions[waypoint].configuration
            switches = 0 if before is None else self._manipulator.switches(before, self.commanded)
            execution.switched(waypoint, switches, now, self._travel)
            self._changed = True

    def _commit(self, states: NDArray[np.uint8], now: float) -> bool:
        """Switches the actuators; returns False if the bus took no frame, to be tried again with the next tick."""
        try:
            self._boards.commit(states, now)
        except BusBusy as error:
            self._busy_since = now if self._busy_since is None else self._busy_since
            if now - self._busy_since > BUSY_FOR:
                self._busy_since = None
                self._fail(Fault("bus-busy", "bus", f"no command could be sent for {BUSY_FOR:g} s: {error}"))
            return False
        self._busy_since = None
        switched = np.flatnonzero(states != self._states)
        self._switches += len(switched)
        self._ledger.switched(switched)
        self._states = states.copy()
        return True

    def _arrived(self, execution: Execution) -> None:
        execution.reported = execution.waypoint
        payload = {
            "id": execution.goal.id,
            "waypoint": execution.waypoint,
            "waypoints": len(execution.plan.solutions),
            "switches": execution.switches,
            **self._where(execution),
        }
        self._publish("feedback", payload)

    def _where(self, execution: Execution) -> Payload:
        """Returns the measured configuration and pose, and its error from the waypoint last switched to."""
        measured = self._boards.measured()
        tip = measured_tip(self._manipulator, measured)
        if tip is None:
            return {"configuration": None, "position": None, "orientation": None, "error": None}
        wanted = execution.plan.trajectory.positions[max(execution.waypoint, 0)]
        error = float(np.linalg.norm(tip[: len(wanted), 3] - wanted))
        configuration = written(self._manipulator, measured)
        return {"configuration": configuration, **pose(self._manipulator, tip), "error": error}

    def _finish(self, execution: Execution) -> None:
        """Ends a goal whose last waypoint is settled, by what the boards measured there."""
        error, tolerance = self._where(execution)["error"], execution.plan.trajectory.tolerance
        if error is not None and error <= tolerance:
            self._end_goal("succeeded", codes.SUCCESSFUL, "reached")
            self._enter("ready", f"holding; goal {execution.goal.id} was reached")
        else:
            where = "unknown" if error is None else f"{error:.4f} from the last waypoint"
            message = f"the measured tip is {where}, tolerance {tolerance:g}"
            self._end_goal("aborted", codes.GOAL_TOLERANCE_VIOLATED, message)
            self._enter("ready", f"holding; goal {execution.goal.id} was missed: {message}")

    def _end_goal(self, status: str, code: int, message: str) -> bool:
        """Tells the running goal its result; returns whether there was one."""
        execution, self._execution = self._execution, None
        if execution is None:
            return False
        result = {"id": execution.goal.id, "status": status, "code": code, "message": message}
        self._publish("result", {**result, "switches": execution.switches, **self._where(execution)})
        self._ledger.ended(self._accepted, status, code, message, execution.switches)
        return True

    # --- modes

    def _enter(self, mode: Mode, reason: str) -> None:
        if (mode, reason) != (self.mode, self.reason):
            log.log(logging.WARNING if mode in ("fault", "stopped") else logging.INFO, "%s: %s", mode, reason)
            self._notifier.send(f"STATUS={mode}: {reason}")
        self.mode, self.reason, self._changed = mode, reason, True

    def _fail(self, fault: Fault) -> None:
        """Holds, aborts the goal, and waits for reset; while starting, the start-up's end decides."""
        if (fault.code, fault.source) not in self._faults:
            log.error("%s: %s", fault.code, fault.message)
        self._faults.setdefault((fault.code, fault.source), fault)
        self._changed = True
        self._end_goal("aborted", codes.PATH_TOLERANCE_VIOLATED, fault.message)
        if self.mode in ("ready", "executing"):
            self._enter("fault", fault.message)

    def _reset(self, reply: Reply) -> None:
        if self.mode in ("fault", "stopped"):
            self._faults.clear()
            self._enter("starting", "the boards are being brought up after a reset")
            self._bring_up()
            reply(answer("resetting; the mode will be ready, or fault with the reason"))
        else:
            reply(answer(f"nothing to reset: the arm is {self.mode}"))

    def _bring_up(self) -> None:
        def work() -> None:
            try:
                faults = self._boards.start()
            except Exception as error:
                log.exception("start-up failed")
                faults = [Fault("internal-error", "daemon", f"start-up failed: {error!r}")]
            self.inbox.put(Started(tuple(faults)))

        threading.Thread(target=work, name="start-up", daemon=True).start()

    def _started(self, faults: tuple[Fault, ...]) -> None:
        if self.mode == "stopped":  # an emergency stop came meanwhile: reset starts again
            return
        for fault in faults:
            self._faults.setdefault((fault.code, fault.source), fault)
        if self._faults:
            for fault in self._faults.values():
                log.error("%s: %s", fault.code, fault.message)
            more = f" (and {len(self._faults) - 1} more)" if len(self._faults) > 1 else ""
            self._enter("fault", next(iter(self._faults.values())).message + more)
            return
        self._boards.hold()
        measured = self._boards.measured()
        try:
            self.commanded = self._manipulator.configuration(measured)
        except ValueError as error:
            self._faults[("unknown-state", "arm")] = Fault("unknown-state", "arm", f"{error}")
            self._enter("fault", f"what the boards measure is no configuration: {error}")
            return
        self._states = measured.astype(np.uint8)
        self._enter("ready", "holding what the boards measured")

    def _show(self, now: float) -> None:
        self._changed, self._next_state = False, now + STATE_EVERY
        execution = self._execution
        self._telemetry.show(
            Snapshot(
                stamp=time.time(),
                mode=self.mode,
                reason=self.reason,
                commanded=self._states,
                measured=self._boards.measured(),
                goal=execution.goal.id if execution else None,
                waypoint=execution.waypoint if execution and execution.waypoint >= 0 else None,
                faults=tuple(self._faults.values()),
            )
        )


def answer(message: str) -> Payload:
    """Returns the reply to a request that was carried out."""
    return {"accepted": True, "code": codes.SUCCESSFUL, "message": message}
