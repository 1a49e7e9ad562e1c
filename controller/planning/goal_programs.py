"""Makes programs from plans: first stages from the arm's latest outputs, times, and the context of the result."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controller.motion.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP, Refusal
from controller.motion.pacing import Staged
from controller.motion.plan import Plan
from controller.motion.program import delay_of
from controller.motion.restaging import restage
from controller.motion.trajectory import Trajectory
from controller.planning.arm_state import ArmState, States
from controller.planning.goal_planning import GoalPlanning, Planned
from controller.planning.goals import RunningGoals
from controller.planning.keep_out import CollisionError
from controller.planning.messages import Reply, done
from controller.planning.monitor import ArmMonitor
from controller.planning.program_feed import ProgramFeed
from controller.planning.reports import GoalReport
from controller.planning.running_goal import RunningGoal
from controller.program import Program

Make = Callable[[ArmState, int, int], RunningGoal]


class GoalPrograms:
    """Makes programs from plans.

    Args:
        planning: that made the plans.
        monitor: of the arm.
        goals: the running goals.
    """

    def __init__(self, planning: GoalPlanning, monitor: ArmMonitor, goals: RunningGoals) -> None:
        self._planning, self._monitor, self._goals = planning, monitor, goals
        self._manipulator, self._pace = planning.arm.manipulator, planning.pace

    def maker(self, goal: str, found: Planned, reply: Reply, proceed: Callable[[], None]) -> Make:
        """Returns a function that makes the program of a plan from the arm's state, a number and an epoch.

        The function raises Refusal if the goal may not begin, and CollisionError if its first stages collide.

        Args:
            goal: its id.
            found: the plan.
            reply: answers the goal when the executor has accepted it.
            proceed: raises Refusal if the goal is no longer wanted.
        """

        def make(state: ArmState, number: int, epoch: int) -> RunningGoal:
            proceed()
            self._check(goal, found)
            return self._program(state, number, epoch, goal, found, reply)

        return make

    def _program(
        self, state: ArmState, number: int, epoch: int, goal: str, found: Planned, reply: Reply
    ) -> RunningGoal:
        stages, plan, strict = self._first_stages(state, found), found.plan, not found.keep_out.free
        trajectory, first = plan.trajectory, plan.transitions[0]
        if stages is not first.stages and not np.array_equal(stages, first.stages):
            plan = replace(plan, transitions=(Staged(stages, None, first.strict), *plan.transitions[1:]))
        begin, delay = self._times(state, trajectory, stages, strict)
        feed = ProgramFeed(self._manipulator, plan, self._pace, delay, state.pack, number, strict)
        report = GoalReport(self._manipulator, goal, trajectory)
        start, name = state.snapshot.outputs, f"goal {goal}"
        program = Program(number, epoch, start, begin, feed.stages, feed.final, strict, name, report.context)
        run = RunningGoal(program, report, feed, len(trajectory.waypoints))
        run.plan, run.delay = plan, delay
        run.on_accepted = lambda: reply({**done(accepted(plan)), "id": goal})
        return run

    def _times(self, state: ArmState, trajectory: Trajectory, stages: States, strict: bool) -> tuple[float, float]:
        """Returns the begin of a program [s], and the delay of its trajectory's t = 0 [s]."""
        now = self._monitor.clock()
        if trajectory.stamp is not None:
            return trajectory.stamp + now - time.time(), 0.0
        waits = max(self._monitor.rest.ready(state, stages[0], strict) - now, 0.0)
        return 0.0, delay_of(trajectory, self._pace.lead * len(stages) + waits)

    def _check(self, goal: str, found: Planned) -> None:
        """Checks that a goal may begin now.

        Raises:
            Refusal: the goal is late, runs already, or was planned among other obstacles.
        """
        trajectory, running = found.plan.trajectory, self._goals.current
        late = 0.0 if trajectory.stamp is None else time.time() - trajectory.stamp - float(trajectory.times[-1])
        if late > 0:
            words = f"stamp: the trajectory ended {late:.3f} s before it was planned"
            raise Refusal(OLD_HEADER_TIMESTAMP, words)
        if running is not None and running.report.id == goal:
            words = f"id: goal {goal} is running already; a goal that replaces it needs another id"
            raise Refusal(INVALID_GOAL, words)
        current = self._planning.now()[1]
        if found.keep_out is not current and not current.free:
            words = "the obstacles changed while the goal was planned; send it again"
            raise Refusal(INVALID_GOAL, words)

    def _first_stages(self, state: ArmState, found: Planned) -> States:
        """Returns the stages (k, A) to a plan's first point from the arm's present state.

        Planned stages among obstacles stay if they are valid from the present state, because they may contain detours.

        Raises:
            CollisionError: the stages would collide.
        """
        planned, keep_out = found.plan.transitions[0].stages, found.keep_out
        if np.array_equal(state.commanded, found.solver.manipulator.actuator_states(found.previous)):
            return planned  # these stages were checked by the planning
        most = self._pace.inrush or len(self._manipulator.actuators)
        rows = np.vstack([state.commanded, planned]).astype(int)
        fits = abs(np.diff(rows, axis=0)).sum(axis=1).max() <= most
        if fits and not keep_out.free and keep_out.first_collision(state.commanded, planned) is None:
            return planned
        stages: NDArray[np.uint8] = restage(self._manipulator, state.commanded, planned, most)
        if (collision := keep_out.first_collision(state.commanded, stages)) is not None:
            raise CollisionError(collision)
        return stages


def accepted(plan: Plan) -> str:
    """Returns the message of an accepted goal."""
    waypoints, switches = len(plan.trajectory.waypoints), plan.switches
    points = f"{waypoints} {'waypoint' if waypoints == 1 else 'waypoints'}"
    return f"accepted, {points}, {switches} {'switch' if switches == 1 else 'switches'} planned"
