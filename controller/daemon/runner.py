"""Goals on the boards: one at a time, each told its result exactly once; or a moving goal, which is followed."""

import logging
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from controller.daemon.events import Follow, Payload, Planned
from controller.daemon.execution import Execution, start
from controller.daemon.ledger import Ledger
from controller.daemon.state import measured_tip, pose, written
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion import codes
from controller.motion.plan import Plan
from drivers.boards import Boards
from drivers.faults import BusBusy

log = logging.getLogger(__name__)

BUSY_FOR = 0.25  # [s]; a bus that takes no frame for longer is a fault


class Runner:
    """Switches the boards to the waypoints of the running goal. The control loop's, called by no other thread.

    Attributes:
        commanded: configuration last switched to or adopted, None before the first.
        states: its actuator states, shape (A,).
        switches: actuators switched since the daemon began.
        execution: of the running goal.
        following: what a moving goal asks for; there is never both.
        free_at: from when on the next transition may begin with the last one settled [s on the loop's clock].

    Args:
        manipulator: the arm.
        boards: connected.
        travel: longest time of an actuator from end-stop to end-stop [s].
        lead: time that is needed from the tick before a switch to its end [s].
        publish: sends a payload on "feedback" or "result"; must not wait.
        ledger: counts switches and goals.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        boards: Boards,
        travel: float,
        lead: float,
        publish: Callable[[str, Payload], None],
        ledger: Ledger,
    ) -> None:
        self.commanded: Configuration | None = None
        self.states: NDArray[np.uint8] | None = None
        self.switches = 0
        self.execution: Execution | None = None
        self.following: Follow | None = None
        self.free_at = 0.0
        self._manipulator, self._boards, self._travel, self._lead = manipulator, boards, travel, lead
        self._publish, self._ledger = publish, ledger
        self._accepted = 0
        self._busy_since: float | None = None

    def forget(self) -> None:
        """Takes the arm's configuration as unknown."""
        self.commanded = self.states = None

    def adopt(self, measured: NDArray[np.int8]) -> None:
        """Takes measured actuator states (A,) as the commanded ones; moves nothing.

        Raises:
            ValueError: they are no configuration of the arm.
        """
        self.commanded = self._manipulator.configuration(measured)
        self.states = measured.astype(np.uint8)

    def objection(self, goal: Planned) -> tuple[int, str] | None:
        """Returns code and sentence of what forbids to begin a goal now, None if nothing does."""
        trajectory = goal.plan.trajectory
        late = 0.0 if trajectory.stamp is None else time.time() - trajectory.stamp - float(trajectory.times[-1])
        if late > 0:
            return codes.OLD_HEADER_TIMESTAMP, f"stamp: the trajectory ended {late:.3f} s before it was planned"
        if self.execution is not None and self.execution.goal.id == goal.id:
            return codes.INVALID_GOAL, f"id: goal {goal.id} is running already; one that replaces it needs its own"
        return None

    def begin(self, goal: Planned, now: float) -> None:
        """Makes a goal the running one."""
        began = start(goal.plan.trajectory, self._lead, now, time.time())
        self.execution = Execution(goal, began, self._lead)
        self._accepted += 1
        self._ledger.accepted(self._accepted, goal.id, len(goal.plan.solutions))

    def improve(self, arrival: int, plan: Plan) -> None:
        """Takes a better plan for what is left of the goal of this arrival, if that is the running one."""
        if self.execution is not None and self.execution.goal.arrival == arrival:
            self.execution.plan = plan

    def follow(self, wish: Follow) -> None:
        """Ends the running goal for a moving one, or has the next of its wishes replace the last."""
        if self.execution is not None:
            self.end("replaced", codes.INVALID_GOAL, "replaced by a setpoint")
        self.following = wish

    def advance(self, now: float) -> str | None:
        """Does what is due at `now`; returns a sentence on the end of the goal or stream when that has come.

        Raises:
            BusBusy: the bus has taken no frame for too long.
        """
        if self.following is not None:
            return self._pursue(self.following, now)
        execution = self.execution
        if execution is None:
            return None
        if execution.reported < execution.waypoint and now >= execution.settled_at and not self._boards.moving(now):
            self._report(execution)
            if execution.last:
                return self._finish(execution)
        waypoint = execution.due(now)
        if waypoint is not None and self._commit(execution.plan.actuator_states[waypoint], now):
            before, self.commanded = self.commanded, execution.plan.solutions[waypoint].configuration
            switches = 0 if before is None else self._manipulator.switches(before, self.commanded)
            execution.switched(waypoint, switches, now, self._travel)
        return None

    def end(self, status: str, code: int, message: str) -> bool:
        """Tells the running goal its result, and follows nothing; returns whether there was a goal."""
        execution, self.execution = self.execution, None
        self.following = self._busy_since = None
        if execution is None:
            return False
        result = {"id": execution.goal.id, "status": status, "code": code, "message": message}
        self._publish("result", {**result, "switches": execution.switches, **self._where(execution)})
        self._ledger.ended(self._accepted, status, code, message, execution.switches)
        return True

    def _pursue(self, wish: Follow, now: float) -> str | None:
        """Switches to the configuration wished for when the last transition is settled.

        Raises:
            BusBusy: the bus has taken no frame for too long.
        """
        if now > wish.until:
            self.following = self._busy_since = None
            return "holding; the stream of setpoints has stopped"
        if wish.configuration is None or wish.previous is not self.commanded:  # switched meanwhile
            self._busy_since = None
        elif self._settled(now) and self._commit(self._manipulator.actuator_states(wish.configuration), now):
            self.commanded = wish.configuration
        return None

    def _settled(self, now: float) -> bool:
        """Returns whether the last transition has come to its end."""
        return now >= self.free_at and not self._boards.moving(now)

    def _commit(self, states: NDArray[np.uint8], now: float) -> bool:
        """Switches the actuators; returns False if the bus took no frame, to be tried again with the next tick."""
        try:
            self._boards.commit(states, now)
        except BusBusy as error:
            if self._busy_since is None:
                self._busy_since = now
            if now - self._busy_since > BUSY_FOR:
                raise BusBusy(f"no command could be sent for {BUSY_FOR:g} s: {error}") from error
            return False
        self._busy_since = None
        self.free_at = now + self._lead
        switched = np.flatnonzero(states != self.states)
        self.switches += len(switched)
        self._ledger.switched(switched)
        self.states = states.copy()
        return True

    def _report(self, execution: Execution) -> None:
        """Tells that the waypoint last switched to is settled."""
        execution.reported = execution.waypoint
        payload = {
            "id": execution.goal.id,
            "waypoint": execution.waypoint,
            "waypoints": len(execution.plan.solutions),
            "switches": execution.switches,
            **self._where(execution),
        }
        self._publish("feedback", payload)

    def _finish(self, execution: Execution) -> str:
        """Ends a goal whose last waypoint is settled, by what the boards measured there."""
        error, tolerance = self._where(execution)["error"], execution.plan.trajectory.tolerance
        if error is not None and error <= tolerance:
            self.end("succeeded", codes.SUCCESSFUL, "reached")
            return f"holding; goal {execution.goal.id} was reached"
        where = "unknown" if error is None else f"{error:.4f} from the last waypoint"
        message = f"the measured tip is {where}, tolerance {tolerance:g}"
        self.end("aborted", codes.GOAL_TOLERANCE_VIOLATED, message)
        return f"holding; goal {execution.goal.id} was missed: {message}"

    def _where(self, execution: Execution) -> Payload:
        """Returns the measured configuration and pose, and its error from the waypoint last switched to."""
        try:
            measured = self._boards.measured()
            tip = measured_tip(self._manipulator, measured)
        except Exception:  # a defect there must not keep a goal from its result
            log.exception("the boards' states cannot be had")
            tip = None
        if tip is None:
            return {"configuration": None, "position": None, "orientation": None, "error": None}
        wanted = execution.plan.trajectory.positions[max(execution.waypoint, 0)]
        error = float(np.linalg.norm(tip[: len(wanted), 3] - wanted))
        configuration = written(self._manipulator, measured)
        return {"configuration": configuration, **pose(self._manipulator, tip), "error": error}
