"""One thread that checks stages for collisions: the executor's questions, and what is left of a running program."""

import logging
import queue
import threading
from collections.abc import Callable, Sequence

import numpy as np

from controller.manipulator.manipulator import Manipulator
from controller.motion.program import unpack_states
from controller.planning.goal_check import touching
from controller.planning.goals import RunningGoals
from controller.planning.keep_out import KeepOut, KeepOutSet, States
from controller.planning.monitor import ArmMonitor
from controller.planning.running_goal import RunningGoal
from controller.program import Clearance, Question

log = logging.getLogger(__name__)

MOST_WAITING = 32

# Takes the obstacles that were checked, and what is touched in words, None for nothing.
OnChecked = Callable[[KeepOutSet, str | None], None]


class ClearanceWorker:
    """Checks one thing after the other; `ask` and `check_rest` may be called from any thread and never wait.

    Args:
        keep_out: the obstacles.
        answer: sends the answer to a question; called from the worker's thread.
    """

    def __init__(self, keep_out: KeepOut, answer: Callable[[Clearance], None]) -> None:
        self._keep_out, self._answer = keep_out, answer
        self._tasks: queue.Queue[Callable[[], None] | None] = queue.Queue(MOST_WAITING)
        self._checks = 0  # of a running program asked for so far; only the latest counts
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="clearance", daemon=True)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Ends the thread after the check under way."""
        with self._lock:
            self._checks += 1
        try:
            self._tasks.put_nowait(None)
        except queue.Full:
            return
        self._thread.join(timeout)

    def waiting(self) -> int:
        """Returns how many checks wait."""
        return self._tasks.qsize()

    def ask(self, question: Question, start: States, stage: States) -> None:
        """Answers a question of the executor: what a stage (A,) touches on the way from actuator states (A,).

        Where there is nothing to keep clear of, the answer is given at once, in the calling thread.
        """
        current = self._keep_out.current
        if current.free:
            self._answer(Clearance(question.question, None))
            return
        try:
            self._tasks.put_nowait(
                lambda: self._answer(Clearance(question.question, self._keep_out.current.touched(start, [stage])))
            )
        except queue.Full:
            self._answer(Clearance(question.question, "too many stages wait to be checked for collisions"))

    def check_rest(self, states: States, stages: Sequence[States], on_checked: OnChecked) -> None:
        """Checks the stages (k, A) that a running program has left, from actuator states (A,) on.

        A check that was asked for before is given up. If the queue is full, the stages count as touching.
        """
        current = self._keep_out.current
        with self._lock:
            self._checks += 1
            number = self._checks

        def latest() -> bool:
            return number == self._checks

        def check() -> None:
            touched = current.touched(states, stages, latest)
            if latest():
                on_checked(current, touched)

        try:
            self._tasks.put_nowait(check)
        except queue.Full:
            on_checked(current, "too many stages wait to be checked for collisions")

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None:
            try:
                task()
            except Exception:
                log.exception("a collision check failed")


class RestCheck:
    """Ends a running goal whose rest would touch something. For any thread; never waits.

    Args:
        manipulator: the whole arm.
        monitor: of the arm.
        goals: that run.
        keep_out: the obstacles.
        worker: that checks.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        monitor: ArmMonitor,
        goals: RunningGoals,
        keep_out: KeepOut,
        worker: ClearanceWorker,
    ) -> None:
        self._actuators = len(manipulator.actuators)
        self._monitor, self._goals, self._keep_out, self._worker = monitor, goals, keep_out, worker

    def check(self) -> None:
        """Has the rest of the running goal checked among the obstacles as they are now, and makes it strict."""
        goal, state, current = self._goals.current, self._monitor.state, self._keep_out.current
        if goal is None or state is None or current.free:
            return
        self._goals.tighten(goal)
        stages = [unpack_states(stage.states, self._actuators) for stage in self._goals.rest(goal)]
        locked, states = state.locked, state.commanded
        # The stages have the output bits of locked actuators; collisions go by the states in which they are.
        real = [np.where(locked, states, stage).astype(np.uint8) for stage in stages]
        self._worker.check_rest(states, real, lambda checked, touched: self._checked(goal, checked, touched))

    def _checked(self, goal: RunningGoal, checked: KeepOutSet, touched: str | None) -> None:
        """Ends the goal if its rest touches something that is still there."""
        if touched is not None and checked is self._keep_out.current:
            self._goals.end(goal, touching(goal.report.id, touched))
