"""Runs goals and jogs in order of arrival, and improves the plans of running goals."""

import logging
import time
import uuid
from dataclasses import dataclass

from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.goal import GoalMessage
from controller.planning.admission import Admission, Ticket
from controller.planning.goal_planning import GoalPlanning, Planned, stages_of
from controller.planning.goal_programs import GoalPrograms
from controller.planning.goals import RunningGoals
from controller.planning.jogging import Jogging, Switches
from controller.planning.keep_out import CollisionError
from controller.planning.messages import BARRED, CLOSING, Payload, Reply
from controller.planning.monitor import ArmMonitor
from controller.planning.request_queue import RequestQueue
from controller.planning.running_goal import RunningGoal
from controller.planning.sending import ProgramSender
from controller.planning.workers.improvement import Improvement

log = logging.getLogger(__name__)

MOST_WAITING = 16
REPLANS = 3  # most plans of a goal whose first stages collide because the arm has moved meanwhile


@dataclass(frozen=True, eq=False)
class GoalRequest:
    """A goal to plan and run, or new states of single actuators.

    Attributes:
        ticket: its place among all requests.
        reply: takes the answer.
        wanted: goal or states.
        received: time of arrival [UNIX s].
        goal: id; None for states.
    """

    ticket: Ticket
    reply: Reply
    wanted: GoalMessage | Switches
    received: float
    goal: str | None


class Planner:
    """Answers each request once: refuses it, or sends it to the executor.

    Attributes:
        requests: the waiting requests.

    Args:
        planning: makes the plans; not shared.
        monitor: of the arm.
        admission: decides which requests are barred.
        goals: the running goals.
        sender: of programs.
        jogging: makes programs of single actuators.
    """

    def __init__(
        self,
        planning: GoalPlanning,
        monitor: ArmMonitor,
        admission: Admission,
        goals: RunningGoals,
        sender: ProgramSender,
        jogging: Jogging,
    ) -> None:
        self._planning, self._monitor, self._admission = planning, monitor, admission
        self._goals, self._sender, self._jogging = goals, sender, jogging
        self._arm, self._pace = planning.arm, planning.pace
        self._programs = GoalPrograms(planning, monitor, goals)
        self._expected: tuple[object, bytes] | None = None  # for which the search is prepared
        self.requests = RequestQueue("goals", MOST_WAITING, self._serve, self._expect)

    def submit(self, payload: bytes, reply: Reply, jog: bool = False) -> None:
        """Queues a request, or refuses it at once. Never waits."""
        self.requests.submit(lambda: self._request(payload, reply, jog), reply)

    def _request(self, payload: bytes, reply: Reply, jog: bool) -> GoalRequest:
        """Decodes a request.

        Raises:
            Refusal: the request is malformed, or far out of reach.
        """
        wanted = self._jogging.decode(payload) if jog else self._planning.read(payload)
        goal = (wanted.id or uuid.uuid4().hex[:12]) if isinstance(wanted, GoalMessage) else None
        return GoalRequest(self._admission.arrive(), reply, wanted, time.time(), goal)

    # --- the thread

    def _expect(self) -> None:
        """Prepares the next search while no request waits; stops as soon as one does."""
        state, (solver, _) = self._monitor.state, self._planning.now()
        if state is None or self._arm.settings.method != "minimum-switch":
            return
        try:
            previous = self._monitor.start(state, solver.manipulator)
        except Refusal:
            return
        if self._expected == (solver, previous.tobytes()):
            return
        for _ in solver.expect(previous, self._arm.tolerance):
            if self.requests.waiting():
                return
        self._expected = solver, previous.tobytes()

    def _proceed(self, request: GoalRequest) -> None:
        """Checks that a request is still wanted.

        Raises:
            Refusal: the daemon shuts down, or the request is barred.
        """
        if self.requests.closing:
            raise Refusal(codes.INVALID_GOAL, CLOSING)
        if self._admission.barred(request.ticket):
            raise Refusal(codes.INVALID_GOAL, BARRED)

    def _serve(self, request: GoalRequest) -> None:
        self._proceed(request)
        self._expected = None
        if isinstance(request.wanted, GoalMessage):
            self._run(request, request.wanted, request.goal or "")
        else:
            self._sender.send(request.ticket, self._jogging.maker(request.wanted, self._accepting(request)))

    def _run(self, request: GoalRequest, message: GoalMessage, goal: str) -> None:
        """Plans a goal, sends it to the executor, and improves its plan.

        Raises:
            Refusal: the goal is not run.
        """
        trajectory = self._planning.trajectory(message, request.received)
        for last in (*[False] * (REPLANS - 1), True):
            found = self._planning.plan(trajectory, lambda: self._proceed(request), run=True)
            try:
                maker = self._programs.maker(goal, found, self._accepting(request), lambda: self._proceed(request))
                run = self._sender.send(request.ticket, maker)
                break
            except CollisionError as error:
                if last:
                    raise Refusal(
                        codes.INVALID_GOAL, f"the motion from the arm's present state would collide: {error}"
                    ) from None
        if self._arm.settings.method == "minimum-switch":
            self._improve(request, run, found)

    def _accepting(self, request: GoalRequest) -> Reply:
        """Returns a function that answers an accepted request; the link's thread calls it."""

        def reply(payload: Payload) -> None:
            self._admission.end_streams(request.ticket)
            request.reply(payload)

        return reply

    # --- while the goal runs

    def _improve(self, request: GoalRequest, run: RunningGoal, found: Planned) -> None:
        """Improves the plan of a running goal until it is complete, the goal ends, or a request waits."""
        plan = run.plan
        if plan is None:
            return
        before, sent = found.solver.manipulator.actuator_states(found.previous), plan
        start = run.begin + run.delay
        try:
            for better in Improvement(found.solver, plan, self._pace, start).plans():
                current = self._planning.now()[1]
                if self.requests.waiting() or not self._goals.runs(run) or current is not found.keep_out:
                    return
                self._proceed(request)
                if better is not sent and current.first_collision(before, stages_of(better)) is None:
                    self._goals.improve(run, better)
                    sent = better
        except Refusal:  # canceled or stopped: the goal has been answered already
            return
        except Exception:
            log.exception("look-ahead failed; the goal continues as first planned")
