"""Programs that the executor runs for this planner: their feedback, and exactly one result each."""

import contextlib
import logging
import threading
from collections.abc import Callable, Sequence

from controller.manipulator.manipulator import Manipulator
from controller.motion import codes
from controller.motion.plan import Plan
from controller.planning.arm_state import Measured, measured_states
from controller.planning.connection import NotConnected
from controller.planning.goal_check import Outcome
from controller.planning.link import ExecutorLink
from controller.planning.reports import outcome_of
from controller.planning.results import Publish, Results
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

GAVE_UP = "the planner gave up waiting for the executor"


class RunningGoals:
    """The programs that are sent, run, or wait for their results. For any thread.

    Attributes:
        last_accepted: number of the latest program that the executor accepted.

    Args:
        manipulator: the whole arm.
        link: to the executor.
        ledger: of goals.
        publish: sends a payload on "feedback", "result", or "inherited" (`Results`); must not wait.
        measured: returns the latest measured states, shape (A,).
        ended: takes the sentence on the end of each program.
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
        self._actuators, self._link, self._ledger, self._publish = len(manipulator.actuators), link, ledger, publish
        self._measured, self._results = measured, Results(manipulator, ledger, publish, ended)
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._goals: dict[int, RunningGoal] = {}
        self.last_accepted = 0

    # --- called by the planner's threads

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
        """Abandons a program that the executor does not answer; returns whether it was accepted meanwhile."""
        with self._lock:
            if not goal.answered.is_set():
                self._results.waive(goal.program.program)
                self._goals.pop(goal.program.program, None)
                self._cancel(goal.program.program, GAVE_UP)
            return goal.accepted

    @property
    def current(self) -> RunningGoal | None:
        """The running program; None if there is none."""
        with self._lock:
            running = [goal for goal in self._goals.values() if goal.accepted]
            return running[-1] if running else None

    @property
    def offered(self) -> bool:
        """Whether a program waits for the executor's answer."""
        with self._lock:
            return any(not goal.answered.is_set() for goal in self._goals.values())

    def runs(self, goal: RunningGoal) -> bool:
        """Returns whether a program is running, and no outcome ends it yet."""
        with self._lock:
            return self._goals.get(goal.program.program) is goal and goal.accepted and goal.outcome is None

    def improve(self, goal: RunningGoal, plan: Plan) -> None:
        """Replaces the stages of a running program that have not begun by those of a better plan."""
        with self._lock:
            if self.runs(goal) and goal.feed is not None:
                goal.feed.improve(plan)
                self._send_more(goal)

    def end(self, goal: RunningGoal, outcome: Outcome) -> None:
        """Cancels a running program at the executor; the outcome becomes its result."""
        with self._lock:
            if self.runs(goal):
                goal.outcome = outcome
                self._cancel(goal.program.program, outcome.message)

    def wait_ended(self, timeout: float) -> None:
        """Waits until no program runs, at most for a time [s]."""
        with self._changed:
            self._changed.wait_for(lambda: not self._goals, timeout)

    def remaining(self, goal: RunningGoal) -> Sequence[Stage]:
        """Returns the stages of a program that have not begun."""
        with self._lock:
            return goal.program.stages if goal.feed is None else goal.feed.remaining()

    def make_strict(self, goal: RunningGoal) -> None:
        """Makes a running program strict, because obstacles were sent."""
        with self._lock:
            if self.runs(goal) and goal.feed is not None:
                goal.feed.make_strict()
                self._send_more(goal)

    # --- called by the link's thread

    def heard(self, message: Up) -> None:
        """Handles a message of the executor."""
        with self._lock:
            match message:
                case Accepted():
                    self._accepted(message)
                case Declined():
                    self._declined(message)
                case Replaced() | Begun():
                    self._continue(message)
                case Settled():
                    self._settled(message)
                case Ended():
                    self._end(message)
                case _:
                    pass

    def lost(self, reason: str) -> None:
        """Ends all programs as aborted, because the executor is lost."""
        with self._lock:
            goals, self._goals = list(self._goals.values()), {}
            for goal in goals:
                if goal.accepted:
                    message = f"{reason}; the arm holds"
                    outcome = goal.outcome or Outcome("aborted", codes.PATH_TOLERANCE_VIOLATED, message, "")
                    self._results.publish(goal, outcome, goal.switches, self._measured())
                goal.answered.set()

    def _accepted(self, message: Accepted) -> None:
        goal = self._goals.get(message.program)
        if goal is None:  # the program was abandoned meanwhile
            self._cancel(message.program, GAVE_UP)
            return
        goal.accepted, goal.begin, self.last_accepted = True, message.begin, message.program
        self._ledger.accepted(message.program, goal.report.id, goal.waypoints)
        goal.on_accepted()
        goal.answered.set()

    def _declined(self, message: Declined) -> None:
        if (goal := self._goals.pop(message.program, None)) is not None:
            goal.declined = message
            goal.answered.set()

    def _continue(self, message: Replaced | Begun) -> None:
        """Sends the next part after a replacement was answered or a stage has begun."""
        goal = self._goals.get(message.program)
        if goal is None or goal.feed is None:
            return
        if isinstance(message, Begun):
            goal.report.begun(goal.feed.begin(message.stage))
        else:
            goal.feed.answered(message.generation, message.accepted)
        self._send_more(goal)

    def _settled(self, message: Settled) -> None:
        goal = self._goals.get(message.program)
        if goal is None:
            return
        goal.switches = message.switches
        deviation = goal.feed.deviation(message.mark) if goal.feed is not None and message.planned else None
        measured = self._states(message.measured, message.known)
        feedback, outcome = goal.report.settled(message.mark, measured, message.switches, message.stages, deviation)
        if feedback is not None:
            self._publish("feedback", feedback)
        if outcome is not None:
            self.end(goal, outcome)

    def _end(self, message: Ended) -> None:
        goal = self._goals.pop(message.program, None)
        measured = self._states(message.measured, message.known)
        if goal is not None:
            goal.answered.set()
            done = message.status == "done"
            outcome = goal.outcome or (goal.report.final_outcome(measured) if done else outcome_of(message))
            self._results.publish(goal, outcome, message.switches, measured, message.travels)
        else:
            self._results.publish_inherited(message, measured)
        with contextlib.suppress(NotConnected):
            self._link.send(Acknowledge(message.result))
        self._changed.notify_all()

    def _send_more(self, goal: RunningGoal) -> None:
        if goal.accepted and goal.feed is not None and (message := goal.feed.message()) is not None:
            with contextlib.suppress(NotConnected):
                self._link.send(message)

    def _cancel(self, program: int, reason: str) -> None:
        with contextlib.suppress(NotConnected):
            self._link.ask(lambda request: Cancel(request, program, reason[:1_000]), lambda answer: None)

    def _states(self, measured: bytes, known: bytes) -> Measured:
        return measured_states(measured, known, self._actuators)
