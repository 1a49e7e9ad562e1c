"""Programs on their way to the executor: sent from the latest outputs, and again if the arm has moved on meanwhile."""

import threading
from collections.abc import Callable

from controller.motion.codes import INVALID_GOAL, Refusal
from controller.planning.admission import Admission, Ticket
from controller.planning.arm_state import ArmState
from controller.planning.connection import NotConnected
from controller.planning.goals import RunningGoals
from controller.planning.messages import BARRED
from controller.planning.monitor import ArmMonitor
from controller.planning.running_goal import RunningGoal

MOST_SENT = 10  # times that a program is sent while the arm moves on


class ProgramNumbers:
    """Numbers programs and streams of set-points, each greater than all before. For any thread."""

    def __init__(self) -> None:
        self._lock, self._last = threading.Lock(), 0

    def next(self) -> int:
        """Returns a new number."""
        with self._lock:
            self._last += 1
            return self._last

    def at_least(self, number: int) -> None:
        """Counts on from the executor's greatest number."""
        with self._lock:
            self._last = max(self._last, number)


class ProgramSender:
    """Has the executor take programs. For any thread.

    Args:
        monitor: of the arm.
        admission: knows which requests are barred.
        goals: that run.
        numbers: of programs.
        patience: time for the executor to answer, which it does within milliseconds [s].
    """

    def __init__(
        self,
        monitor: ArmMonitor,
        admission: Admission,
        goals: RunningGoals,
        numbers: ProgramNumbers,
        patience: float,
    ) -> None:
        self._monitor, self._admission, self._goals, self._numbers = monitor, admission, goals, numbers
        self._patience = patience

    def send(self, ticket: Ticket, make: Callable[[ArmState, int, int], RunningGoal]) -> RunningGoal:
        """Returns a program that the executor has taken.

        Args:
            ticket: of the request.
            make: makes the program from the arm's state, with a number and an epoch; called again if the arm has moved.

        Raises:
            Refusal: the executor does not take it, or `make` refuses.
        """
        for _ in range(MOST_SENT):
            epoch = self._admission.epoch(ticket, self._patience)
            state = self._monitor.require()
            if epoch is None:
                raise Refusal(INVALID_GOAL, "the executor does not answer a request that came before; try again")
            goal = make(state, self._numbers.next(), epoch)
            try:
                self._goals.offer(goal)
            except NotConnected as error:
                raise Refusal(INVALID_GOAL, f"the executor does not take it: {error}") from None
            if self._taken(goal):
                return goal
            self._monitor.wait_newer(state)
        raise Refusal(INVALID_GOAL, "the arm moved on each time that the goal was to begin; send it again")

    def _taken(self, goal: RunningGoal) -> bool:
        """Waits for the executor's answer; returns whether a program runs, or is to be made anew.

        Raises:
            Refusal: it does not run.
        """
        if not goal.answered.wait(self._patience) and not self._goals.withdraw(goal):
            raise Refusal(INVALID_GOAL, f"the executor did not answer within {self._patience:g} s")
        if goal.accepted:
            return True
        declined = goal.declined
        if declined is None:
            raise Refusal(INVALID_GOAL, "the executor was lost before it took the goal; the arm holds")
        if declined.cause == "moved":
            return False
        raise Refusal(INVALID_GOAL, BARRED if declined.cause == "epoch" else declined.reason)
