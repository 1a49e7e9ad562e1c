"""A thread that checks stages for collisions: questions of the executor, and remaining stages of a running program."""

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from controller.manipulator.manipulator import Manipulator
from controller.motion.program import unpack_states
from controller.planning.goal_check import collision_outcome
from controller.planning.goals import RunningGoals
from controller.planning.keep_out import KeepOut
from controller.planning.monitor import ArmMonitor
from controller.planning.running_goal import RunningGoal
from controller.planning.workers.arm_model import Abandoned
from controller.planning.workers.keep_out import KeepOutSet, States
from controller.program import Clearance, Question

log = logging.getLogger(__name__)

MOST_WAITING = 32

# Takes the obstacles of the check, and the collision in words, None if there is none.
OnChecked = Callable[[KeepOutSet, str | None], None]


class ClearanceWorker:
    """Checks one task after the other. `ask` and `check_remaining` may be called from any thread and never wait.

    Args:
        keep_out: the obstacles.
        answer: sends the answer to a question; called from the worker's thread.
    """

    def __init__(self, keep_out: KeepOut, answer: Callable[[Clearance], None]) -> None:
        self._keep_out, self._answer = keep_out, answer
        self._tasks: queue.Queue[Callable[[], None] | None] = queue.Queue(MOST_WAITING)
        self._checks = 0  # number of calls of check_remaining; only the latest counts
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="clearance", daemon=True)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Ends the thread after the present check."""
        with self._lock:
            self._checks += 1
        try:
            self._tasks.put_nowait(None)
        except queue.Full:
            return
        self._thread.join(timeout)

    def waiting(self) -> int:
        """Returns the number of waiting checks."""
        return self._tasks.qsize()

    def ask(self, question: Question, start: States, stage: States) -> None:
        """Answers the executor's question: what a stage (A,) collides with, from actuator states (A,).

        Without obstacles the answer is sent at once, in the calling thread.
        """
        current = self._keep_out.current
        if current.free:
            self._answer(Clearance(question.question, None))
            return
        try:
            self._tasks.put_nowait(
                lambda: self._answer(
                    Clearance(question.question, self._keep_out.current.first_collision(start, [stage]))
                )
            )
        except queue.Full:
            self._answer(Clearance(question.question, "too many stages wait to be checked for collisions"))

    def check_remaining(self, states: States, stages: Sequence[States], on_checked: OnChecked) -> None:
        """Checks the remaining stages (k, A) of a running program, from actuator states (A,).

        A new call abandons the check of an earlier one. If the queue is full, the stages count as colliding.
        """
        current = self._keep_out.current
        with self._lock:
            self._checks += 1
            number = self._checks

        def proceed() -> None:
            if number != self._checks:
                raise Abandoned

        def check() -> None:
            with suppress(Abandoned):
                collision = current.first_collision(states, stages, proceed)
                proceed()
                on_checked(current, collision)

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


class RemainingCheck:
    """Ends a running goal whose remaining stages would collide. For any thread; never waits.

    Args:
        manipulator: the whole arm.
        monitor: of the arm.
        goals: the running goals.
        keep_out: the obstacles.
        worker: does the checks.
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
        """Checks the running goal's remaining stages against the present obstacles, and makes its program strict."""
        goal, state, current = self._goals.current, self._monitor.state, self._keep_out.current
        if goal is None or state is None or current.free:
            return
        self._goals.make_strict(goal)
        stages = [unpack_states(stage.states, self._actuators) for stage in self._goals.remaining(goal)]
        locked, states = state.locked, state.commanded
        # The stages have the output bits of locked actuators; the check needs their locked states.
        real = [np.where(locked, states, stage).astype(np.uint8) for stage in stages]
        self._worker.check_remaining(states, real, lambda checked, collision: self._checked(goal, checked, collision))

    def _checked(self, goal: RunningGoal, checked: KeepOutSet, collision: str | None) -> None:
        """Ends the goal if its remaining stages collide with obstacles that are still present."""
        if collision is not None and checked is self._keep_out.current:
            self._goals.end(goal, collision_outcome(goal.report.id, collision))
