"""Programs that the executor runs for this planner: each is told its feedback, and exactly one result."""

import contextlib
import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence

from controller.manipulator.manipulator import Manipulator
from controller.motion import codes
from controller.motion.plan import Plan
from controller.planning.arm_state import Measured, measured_states
from controller.planning.connection import NotConnected
from controller.planning.context import decode_context
from controller.planning.goal_check import Verdict
from controller.planning.link import ExecutorLink
from controller.planning.messages import Payload
from controller.planning.reports import foreign_result, result, verdict_of
from controller.planning.running_goal import GoalLedger, RunningGoal
from controller.program import (
    Accepted,
    Acknowledge,
    Begun,
    Cancel,
    Declined,
    Ended,
    Replaced,
    Settled,
    Stage,
    Up,
)

log = logging.getLogger(__name__)

REMEMBERED = 1_000  # results that were told, which the executor may send again

Publish = Callable[[str, Payload], None]


class RunningGoals:
    """The programs that are sent, run, or wait for their results. For any thread.

    Args:
        manipulator: the whole arm.
        link: to the executor.
        ledger: of goals.
        publish: sends a payload on "feedback" or "result"; must not wait.
        measured: returns the latest measured states, shape (A,).
        ended: told the sentence on the end of each program.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        link: ExecutorLink,
        ledger: GoalLedger,
        publish: Publish,
        measured: Callable[[], Measured],
        ended: Callable[[str], None],
    ) -> None:
        self._manipulator, self._link, self._ledger, self._publish = manipulator, link, ledger, publish
        self._measured, self._ended = measured, ended
        self._lock = threading.RLock()
        self._goals: dict[int, RunningGoal] = {}
        self._told: deque[int] = deque(maxlen=REMEMBERED)  # programs whose result was published

    # --- from the planner's threads

    def offer(self, goal: RunningGoal) -> None:
        """Sends a program.

        Raises:
            NotConnected: there is no executor.
        """
        with self._lock:
            self._goals[goal.program.program] = goal
            try:
                self._link.send(goal.program)
            except NotConnected:
                del self._goals[goal.program.program]
                raise

    def withdraw(self, goal: RunningGoal) -> bool:
        """Gives up a program that the executor does not answer; returns whether it was taken meanwhile."""
        with self._lock:
            if not goal.answered.is_set():
                self._told.append(goal.program.program)
                self._goals.pop(goal.program.program, None)
                self._cancel(goal.program.program, "the planner gave up waiting for the executor")
            return goal.accepted

    @property
    def current(self) -> RunningGoal | None:
        """The running one; None if there is none."""
        with self._lock:
            running = [goal for goal in self._goals.values() if goal.accepted]
            return running[-1] if running else None

    @property
    def offered(self) -> bool:
        """Whether a program waits for the executor's answer."""
        with self._lock:
            return any(not goal.answered.is_set() for goal in self._goals.values())

    def runs(self, goal: RunningGoal) -> bool:
        """Returns whether a program is running and not about to end."""
        with self._lock:
            return self._goals.get(goal.program.program) is goal and goal.accepted and goal.verdict is None

    def improve(self, goal: RunningGoal, plan: Plan) -> None:
        """Takes a better plan for what a program has not begun."""
        with self._lock:
            if self.runs(goal) and goal.feed is not None:
                goal.feed.improve(plan)
                self._send_more(goal)

    def end(self, goal: RunningGoal, verdict: Verdict) -> None:
        """Has the executor hold, as a verdict ends a program."""
        with self._lock:
            if self.runs(goal):
                goal.verdict = verdict
                self._cancel(goal.program.program, verdict.message)

    def rest(self, goal: RunningGoal) -> Sequence[Stage]:
        """Returns the stages of a program that have not begun."""
        with self._lock:
            return goal.program.stages if goal.feed is None else goal.feed.rest()

    def tighten(self, goal: RunningGoal) -> None:
        """Makes a running program strict, as obstacles have come."""
        with self._lock:
            if self.runs(goal) and goal.feed is not None:
                goal.feed.tighten()
                self._send_more(goal)

    # --- from the link's thread

    def heard(self, message: Up) -> None:
        """Acts on a message of the executor."""
        with self._lock:
            match message:
                case Accepted():
                    self._accepted(message)
                case Declined():
                    if (goal := self._goals.pop(message.program, None)) is not None:
                        goal.declined = message
                        goal.answered.set()
                case Replaced():
                    if (goal := self._goals.get(message.program)) is not None and goal.feed is not None:
                        goal.feed.answered(message.generation, message.accepted)
                        self._send_more(goal)
                case Begun():
                    if (goal := self._goals.get(message.program)) is not None and goal.feed is not None:
                        goal.report.begun(goal.feed.begin(message.stage))
                        self._send_more(goal)
                case Settled():
                    self._settled(message)
                case Ended():
                    self._end(message)
                case _:
                    pass

    def lost(self, reason: str) -> None:
        """Tells every program that it is aborted, as the executor is gone."""
        with self._lock:
            goals, self._goals = list(self._goals.values()), {}
            for goal in goals:
                if goal.accepted:
                    message = f"{reason}; the arm holds"
                    verdict = goal.verdict or Verdict("aborted", codes.PATH_TOLERANCE_VIOLATED, message, "")
                    self._tell(goal, verdict, goal.switches, self._measured())
                goal.answered.set()

    def _accepted(self, message: Accepted) -> None:
        goal = self._goals.get(message.program)
        if goal is None:  # it was given up meanwhile
            self._cancel(message.program, "the planner gave up waiting for the executor")
            return
        goal.accepted, goal.begin = True, message.begin
        self._ledger.accepted(message.program, goal.report.id, goal.waypoints)
        goal.on_accepted()
        goal.answered.set()

    def _settled(self, message: Settled) -> None:
        goal = self._goals.get(message.program)
        if goal is None:
            return
        goal.switches = message.switches
        known = message.planned and goal.feed is not None
        excursion = goal.feed.excursion(message.mark) if known and goal.feed is not None else None
        measured = self._states(message.measured, message.known)
        told, verdict = goal.report.settled(message.mark, measured, message.switches, message.stages, excursion)
        if told is not None:
            self._publish("feedback", told)
        if verdict is not None:
            self.end(goal, verdict)

    def _end(self, message: Ended) -> None:
        goal = self._goals.pop(message.program, None)
        measured = self._states(message.measured, message.known)
        if goal is not None:
            goal.answered.set()
            done = message.status == "done"
            verdict = goal.verdict or (goal.report.judged(measured) if done else verdict_of(message))
            self._tell(goal, verdict, message.switches, measured)
        elif message.program not in self._told:
            self._tell_foreign(message, measured)
        with contextlib.suppress(NotConnected):
            self._link.send(Acknowledge(message.result))

    def _tell(self, goal: RunningGoal, verdict: Verdict, switches: int, measured: Measured) -> None:
        """Publishes the result of a program."""
        number = goal.program.program
        self._told.append(number)
        self._publish("result", result(goal.report.id, verdict, switches, goal.report.where(measured)))
        self._ledger.ended(number, verdict.status, verdict.code, verdict.message, switches)
        if verdict.sentence:
            self._ended(verdict.sentence)

    def _tell_foreign(self, message: Ended, measured: Measured) -> None:
        """Publishes the result of a program that another run of the planner sent."""
        self._told.append(message.program)
        context = decode_context(message.context)
        if context is None:
            log.warning("the result of program %d is not for this planner: %s", message.program, message.message)
            return
        payload = foreign_result(self._manipulator, message, measured, context)
        self._publish("result", payload)
        told = payload["status"], payload["code"], payload["message"]
        self._ledger.ended(message.program, *told, message.switches)

    def _send_more(self, goal: RunningGoal) -> None:
        if goal.accepted and goal.feed is not None and (message := goal.feed.message()) is not None:
            with contextlib.suppress(NotConnected):
                self._link.send(message)

    def _cancel(self, program: int, reason: str) -> None:
        with contextlib.suppress(NotConnected):
            self._link.ask(lambda request: Cancel(request, program, reason[:1_000]), lambda answer: None)

    def _states(self, measured: bytes, known: bytes) -> Measured:
        return measured_states(measured, known, len(self._manipulator.actuators))
