"""The planner, assembled from its parts, as the gateway uses it."""

import logging
from collections.abc import Callable, Collection, Sequence
from typing import Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from controller.config import Arm
from controller.manipulator.locked import LockedStates, lock_actuators
from controller.motion.codes import PATH_TOLERANCE_VIOLATED, Refusal
from controller.motion.pacing import pace_of
from controller.motion.requests import decode_degrade, decode_obstacles
from controller.planning.admission import Admission, Receive
from controller.planning.clearance_worker import ClearanceWorker, RemainingCheck
from controller.planning.description import density, description, drawing, file
from controller.planning.executor_listener import ExecutorListener
from controller.planning.follower import Follower
from controller.planning.goal_check import Outcome
from controller.planning.goal_planning import GoalPlanning
from controller.planning.goals import RunningGoals
from controller.planning.jogging import Jogging
from controller.planning.keep_out import CollisionAwareSolver, KeepOut, sentence
from controller.planning.link import ExecutorLink
from controller.planning.locked import LockedActuators
from controller.planning.messages import CLOSING, Payload, Reply, done, refused
from controller.planning.monitor import ArmMonitor
from controller.planning.plan_queries import PlanQueries
from controller.planning.planner import Planner
from controller.planning.requests import Requests
from controller.planning.results import Publish
from controller.planning.running_goal import GoalLedger
from controller.planning.sending import ProgramNumbers, ProgramSender
from controller.planning.status_report import DiagnosticsReport, StatusReport
from controller.planning.tip_bias import TipBiasWorker
from controller.search.solver import Solver
from controller.workspace.densities import Densities
from controller.workspace.mapping import map_densities

log = logging.getLogger(__name__)

LAST_RESULTS_WITHIN = 1.0  # [s] at the end for the executor to end the running goal


class Ledger(GoalLedger, Protocol):
    """Records goals, results and switches; must not wait."""

    fault: str | None
    instance: int

    def counts(self, counts: Sequence[int]) -> None:
        """Takes the executor's counts, one for each actuator."""

    def known(self) -> Sequence[int]:
        """Returns the number of switches of each actuator so far."""


class Planning:
    """The planner as the gateway uses it. For any thread; all methods but `close` and `end_goals` return at once.

    Args:
        arm: with wiring.
        densities: of the arm reduced by the actuators that its file declares stuck.
        link: to the executor; started and closed with this object.
        ledger: of goals and switches.
        publish: sends a payload on "feedback", "result", or "inherited" (`Results`); must not wait.
        on_change: called when `state` has changed, and 20 times a second; must not wait.
    """

    def __init__(
        self,
        arm: Arm,
        densities: Densities,
        link: ExecutorLink,
        ledger: Ledger,
        publish: Publish,
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        self._arm, self._link, manipulator = arm, link, arm.manipulator
        self._weights = arm.weights(dict(zip(manipulator.actuators, ledger.known(), strict=False)))
        self._keep_out, self._admission, numbers = KeepOut(arm), Admission(), ProgramNumbers()
        self._solvers = [
            CollisionAwareSolver(arm, solver, self._keep_out) for solver in self._tables(arm.locked, densities)
        ]
        self._monitor = ArmMonitor(manipulator, link, arm.travel_time, pace_of(arm.settings))
        self._locked = LockedActuators(manipulator, arm.locked, self._rebuild, on_change)
        self._monitor.set_locks(self._locked)
        self._tip_bias = TipBiasWorker(self._monitor, arm.settings.tracker) if arm.settings.tracker else None
        self._goals = RunningGoals(
            manipulator, link, ledger, publish, lambda: self._monitor.measured, self._monitor.ended
        )
        self._clearance = ClearanceWorker(self._keep_out, link.send)
        for_goals, for_queries, for_setpoints = self._solvers
        self._planner = Planner(
            GoalPlanning(arm, for_goals, self._monitor, self._bias),
            self._monitor,
            self._admission,
            self._goals,
            ProgramSender(self._monitor, self._admission, self._goals, numbers, link.patience),
            Jogging(arm, self._keep_out),
        )
        queries = GoalPlanning(arm, for_queries, self._monitor, self._bias)
        self._queries = PlanQueries(queries, lambda: self._planner.requests.waiting() > 0)
        self._follower = Follower(
            arm, for_setpoints, self._monitor, self._admission, self._goals, numbers, link.send, self._bias
        )
        self._requests = Requests(link, self._monitor, self._admission, self._goals, self._locked)
        self._listener = ExecutorListener(
            link, self._monitor, self._admission, self._goals, self._locked, self._clearance, numbers, ledger, on_change
        )
        self._remaining_check = RemainingCheck(manipulator, self._monitor, self._goals, self._keep_out, self._clearance)
        bias, tracker = (self._tip_bias.state_fields, self._tracker) if self._tip_bias else (dict, dict)
        self._status = StatusReport(self._monitor, link, self._goals, self._locked, self._keep_out, bias)
        self._diagnostics = DiagnosticsReport(
            link, lambda: self._listener.counted, self._queues, self._follower.status, lambda: ledger.fault, tracker
        )
        self._description = description(arm)
        self._densities, self._sent = densities, list[Any]()
        self._on_change = on_change

    def start(self) -> None:
        """Starts all threads; the link to the executor is last."""
        for part in (self._clearance, self._planner.requests, self._queries.requests, self._follower):
            part.start()
        if self._tip_bias is not None:
            self._tip_bias.start()
        self._link.start(self._listener)

    def end_goals(self) -> None:
        """Refuses waiting requests, ends the running goal and publishes its result; the executor stays connected."""
        for part in (self._follower, self._planner.requests, self._queries.requests):
            part.close()
        if (running := self._goals.current) is not None:
            self._goals.end(running, Outcome("aborted", PATH_TOLERANCE_VIOLATED, CLOSING, ""))
            self._goals.wait_ended(LAST_RESULTS_WITHIN)

    def close(self) -> None:
        """Ends goals, the connection to the executor, and all threads."""
        self.end_goals()
        self._link.close()
        self._clearance.close()
        if self._tip_bias is not None:
            self._tip_bias.close()

    # --- requests

    def goal(self, payload: bytes, reply: Reply) -> None:
        """Plans and runs a goal."""
        self._planner.submit(payload, reply)

    def plan(self, payload: bytes, reply: Reply) -> None:
        """Answers with the plan of a goal, without running it."""
        self._queries.submit(payload, reply)

    def jog(self, payload: bytes, reply: Reply) -> None:
        """Switches single actuators."""
        self._planner.submit(payload, reply, jog=True)

    def cancel(self, reply: Reply) -> None:
        """Ends the running goal or stream; the arm holds."""
        self._requests.cancel(reply)

    def stop(self, reply: Reply) -> None:
        """Stops the arm until a reset."""
        self._requests.stop(reply)

    def reset(self, reply: Reply) -> None:
        """Leaves a fault or a stop."""
        self._requests.reset(reply)

    def degrade(self, payload: bytes, reply: Reply) -> None:
        """Locks or unlocks an actuator."""
        try:
            self._requests.lock(decode_degrade(payload), reply)
        except Refusal as refusal:
            reply(refused(refusal.code, str(refusal)))

    def obstacles(self, payload: bytes, reply: Reply) -> None:
        """Replaces the obstacles that were sent before; nothing moves."""
        try:
            sent = decode_obstacles(payload, self._arm.manipulator.dimension)
        except Refusal as refusal:
            reply(refused(refusal.code, str(refusal)))
            return
        if self._keep_out.change(sent):
            self._sent = msgspec.json.decode(payload)["regions"]
            self._remaining_check.check()
            self._on_change()
        state = self._monitor.state
        reply(done(sentence(self._keep_out.current, None if state is None else state.measured)))

    def setpoints(self, receive: Receive) -> None:
        """Sets the mailbox of set-points: `receive` returns the latest, or None, and never waits."""
        self._admission.read_setpoints(receive)

    def measured_tips(self, receive: Receive) -> None:
        """Sets the mailbox of measured tips; see `setpoints`."""
        if self._tip_bias is not None:
            self._tip_bias.read(receive)

    # --- reports

    def state(self) -> Payload:
        """Returns the payload of `state`."""
        return self._status.state()

    def diagnostics(self) -> Payload:
        """Returns the payload of `diagnostics`."""
        return self._diagnostics.diagnostics()

    def description(self, wanted: Collection[str] = ()) -> Payload:
        """Returns the payload of `arm`; `limits` are sentences on limits of its boards.

        Args:
            wanted: parts to include: "drawing", "file", "density", and "running", the waypoints of the running goal.
        """
        state = self._monitor.state
        faults = () if state is None else state.snapshot.faults
        limits = [fault.message for fault in faults if fault.code == "board-limits"]
        made: dict[str, Callable[[], Payload | None]] = {
            "drawing": lambda: drawing(self._arm),
            "file": lambda: file(self._arm),
            "density": lambda: density(self._densities, planar=self._arm.manipulator.planar),
            "running": self._running,
        }
        besides = {name: make() for name, make in made.items() if name in wanted}
        return {**self._description, "limits": limits, "sent_obstacles": self._sent, **besides}

    def _running(self) -> Payload | None:
        """Returns id and waypoints of the running goal; None if there is none."""
        goal = self._goals.current
        return None if goal is None else {"goal": goal.report.id, "waypoints": goal.report.waypoints}

    def _queues(self) -> dict[str, int]:
        waiting = self._link.waiting + self._clearance.waiting()
        planning = self._planner.requests.waiting() + self._queries.requests.waiting()
        return {"inbox": waiting, "planning": planning}

    def _tracker(self) -> Payload:
        return {} if self._tip_bias is None else {"tracker": self._tip_bias.status()}

    def _bias(self) -> NDArray[np.float64] | None:
        return None if self._tip_bias is None else self._tip_bias.bias()

    # --- changes

    def _tables(self, locked: LockedStates, densities: Densities | None = None) -> list[Solver]:
        """Returns the solvers for goals, plan queries and set-points, for the arm reduced by locked states (A,)."""
        reduced = lock_actuators(self._arm.manipulator, locked)
        if densities is None:
            densities = map_densities(reduced, self._arm.pixel, self._arm.level_pixels)
        else:
            reduced = self._arm.reduced
        for_goals = Solver(reduced, densities, self._weights)
        for_goals.prepare()
        return [for_goals, for_goals.another(), for_goals.another()]

    def _rebuild(self, locked: LockedStates) -> None:
        """Rebuilds all solvers for locked states (A,)."""
        for part, solver in zip(self._solvers, self._tables(locked), strict=True):
            part.use(solver)
