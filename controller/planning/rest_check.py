"""What is left of a running program, checked for collisions when the obstacles have changed."""

import numpy as np

from controller.manipulator.manipulator import Manipulator
from controller.motion.program import unpack_states
from controller.planning.clearance_worker import ClearanceWorker
from controller.planning.goal_check import touching
from controller.planning.goals import RunningGoals
from controller.planning.keep_out import KeepOut, KeepOutSet
from controller.planning.monitor import ArmMonitor
from controller.planning.running_goal import RunningGoal


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
