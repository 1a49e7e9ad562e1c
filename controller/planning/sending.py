"""Sends programs to the executor: from the latest outputs, and again if the arm has moved meanwhile."""

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

MOST_SENT = 10  # most attempts to send a program while the arm moves


class ProgramNumbers:
    """Numbers programs and streams of set-points in ascending order. For any thread."""

    def __init__(self) -> None:
        self._lock, self._last = threading.Lock(), 0

    def next(self) -> int:
        """Returns a new number."""
        with self._lock:
            self._last += 1
            return self._last

    def at_least(self, number: int) -> None:
        """Continues after the executor's greatest number."""
        with self._lock:
            self._last = max(self._last, number)


class ProgramSender:
    """Sends programs and waits for their acceptance. For any thread.

    Args:
        monitor: of the arm.
        admission: decides which requests are barred.
        goals: the running goals.
        numbers: of programs.
        patience: longest time for an answer [s]; the executor answers within milliseconds.
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
        """Returns a program that the executor has accepted.

        Args:
            ticket: of the request.
            make: makes the program from the arm's state, a number and an epoch; called again if the arm has moved.

        Raises:
            Refusal: the executor does not accept it, or `make` refuses.
        """
        for _ in range(MOST_SENT):
            epoch = self._admission.epoch(ticket, self._patience)
            state = self._monitor.require()
            if epoch is None:
                raise Refusal(INVALID_GOAL, "the executor has not answered an earlier request; send it again")
            goal = make(state, self._numbers.next(), epoch)
            try:
                self._goals.offer(goal)
            except NotConnected as error:
                raise Refusal(INVALID_GOAL, f"the executor cannot accept it: {error}") from None
            if self._taken(goal):
                return goal
            self._monitor.wait_newer(state)
        raise Refusal(INVALID_GOAL, "the arm moved each time before the goal could begin; send it again")

    def _taken(self, goal: RunningGoal) -> bool:
        """Waits for the executor's answer; returns False if the program must be made again.

        Raises:
            Refusal: the program does not run.
        """
        if not goal.answered.wait(self._patience) and not self._goals.withdraw(goal):
            raise Refusal(INVALID_GOAL, f"the executor did not answer within {self._patience:g} s")
        if goal.accepted:
            return True
        declined = goal.declined
        if declined is None:
            raise Refusal(
                INVALID_GOAL, "the connection to the executor was lost before it accepted the goal; the arm holds"
            )
        if declined.cause == "moved":
            return False
        raise Refusal(INVALID_GOAL, BARRED if declined.cause == "epoch" else declined.reason)
