"""Planning beside the control loop: one thread takes payloads in order of arrival and makes plans of them."""

import logging
import queue
import threading
import uuid
from dataclasses import dataclass

from controller.config import Arm
from controller.daemon.events import Payload, Planned, Reply
from controller.daemon.loop import PERIOD, ControlLoop
from controller.daemon.state import pose
from controller.manipulator.notation import format_configuration
from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.goal import Trajectory, decode
from controller.motion.plan import Plan, plan
from controller.search.solver import Solver

log = logging.getLogger(__name__)

MOST_WAITING = 16


@dataclass(frozen=True, eq=False)
class Request:
    """A payload to plan: a goal to run, or a question only."""

    payload: bytes
    arrival: int
    received: float
    run: bool
    reply: Reply


class Planner:
    """Answers every request once: itself when refused or only asked, by the control loop when it is to be run."""

    def __init__(self, arm: Arm, solver: Solver, loop: ControlLoop) -> None:
        """Starts the thread."""
        self._arm, self._solver, self._loop = arm, solver, loop
        self._queue: queue.Queue[Request | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name="planner", daemon=True)
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Takes a request, or refuses it at once when too many wait."""
        try:
            self._queue.put_nowait(request)
        except queue.Full:
            request.reply(refused(codes.INVALID_GOAL, f"busy: {MOST_WAITING} goals are waiting to be planned already"))

    def waiting(self) -> int:
        """Returns how many requests wait."""
        return self._queue.qsize()

    def _run(self) -> None:
        while (request := self._queue.get()) is not None:
            try:
                self._serve(request)
            except Refusal as refusal:
                log.info("goal refused: %s", refusal)
                request.reply(refused(refusal.code, str(refusal)))
            except Exception:
                log.exception("planning failed")
                request.reply(refused(codes.INVALID_GOAL, "internal error while planning, see the journal"))

    def _serve(self, request: Request) -> None:
        trajectory = decode(
            request.payload,
            self._arm.manipulator.dimension,
            self._arm.tolerance,
            shortest=self._arm.settings.travel_time + PERIOD,
            now=request.received,
        )
        previous = self._loop.commanded
        if previous is None:
            raise Refusal(codes.INVALID_GOAL, f"the arm is {self._loop.mode}: {self._loop.reason}")
        found = plan(self._solver, trajectory, previous, self._arm.settings.method)
        if request.run:
            goal = trajectory.id or uuid.uuid4().hex[:12]
            self._loop.inbox.put(Planned(goal, found, request.arrival, request.reply))
        else:
            request.reply(self._described(trajectory, found))

    def _described(self, trajectory: Trajectory, found: Plan) -> Payload:
        manipulator = self._arm.manipulator
        waypoints = [
            {
                "t": float(t - trajectory.times[0]),
                "goal": goal.tolist(),
                "configuration": format_configuration(manipulator, solution.configuration),
                **pose(manipulator, solution.tip),
                "error": solution.error,
                "switches": solution.switches,
                "seconds": solution.seconds,
            }
            for t, goal, solution in zip(trajectory.times, trajectory.positions, found.solutions, strict=True)
        ]
        return {
            "accepted": True,
            "code": codes.SUCCESSFUL,
            "message": f"{len(waypoints)} waypoints, {found.switches} switches",
            "waypoints": waypoints,
            "switches": found.switches,
        }


def refused(code: int, message: str) -> Payload:
    """Returns the reply to a goal that is not accepted."""
    return {"accepted": False, "code": code, "message": message}
