"""Plans goals from the arm's present state. Each thread has its own instance."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controller.config import Arm
from controller.manipulator.manipulator import Configuration
from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.goal import GoalMessage, parse, schedule
from controller.motion.pacing import pace_of
from controller.motion.plan import Plan
from controller.motion.point_by_point import PLANNING_TIME, plan
from controller.motion.trajectory import Trajectory
from controller.planning.arm_state import ArmState
from controller.planning.keep_out import CollisionAwareSolver
from controller.planning.monitor import ArmMonitor
from controller.planning.program_feed import most_stages
from controller.planning.workers.keep_out import KeepOutSet
from controller.program import MOST_PROGRAM_STAGES
from controller.search.solver import Solver

TRIES = 3  # most plans of a goal while the arm moves or the obstacles change

Bias = Callable[[], NDArray[np.float64] | None]


@dataclass(frozen=True, eq=False)
class Planned:
    """A plan, and what it was made from.

    Attributes:
        plan: of the goal.
        state: of the arm before the plan.
        previous: configuration before the plan, of the solver's arm, shape (B,).
        solver: that found the plan.
        keep_out: obstacles of the plan.
    """

    plan: Plan
    state: ArmState
    previous: Configuration
    solver: Solver
    keep_out: KeepOutSet


class GoalPlanning:
    """Plans goals. Belongs to one thread.

    Args:
        arm: to plan for.
        solver: not shared.
        monitor: of the arm.
        bias: returns the tip bias that corrects goals, shape (dimension,); None: no tracker.
    """

    def __init__(self, arm: Arm, solver: CollisionAwareSolver, monitor: ArmMonitor, bias: Bias) -> None:
        self.arm, self.pace = arm, pace_of(arm.settings)
        self._solver, self._monitor, self._bias = solver, monitor, bias
        manipulator, tracker = arm.manipulator, arm.settings.tracker
        self._base = manipulator.base[: manipulator.dimension, 3]
        self._farthest = manipulator.length + (tracker.clamp if tracker else 0.0)  # of a tip from the base

    def now(self) -> tuple[Solver, KeepOutSet]:
        """Returns the present solver, and the obstacles that it avoids."""
        return self._solver.now()

    def read(self, payload: bytes) -> GoalMessage:
        """Decodes a goal, in microseconds. Positions beyond the arm's length are refused here, without a search.

        Raises:
            Refusal: the goal is malformed, or a position is farther than the arm's length.
        """
        message = parse(payload)
        tolerance = message.tolerance.position or self.arm.tolerance
        for k, waypoint in enumerate(message.waypoints):
            position = waypoint.position
            if position is None or len(position) != len(self._base):
                continue
            away = math.dist(position, self._base)
            if away > self._farthest + tolerance:
                where = f"waypoints[{k}].position: ({', '.join(f'{x:g}' for x in position)}) is out of reach"
                words = f"{where}: {away:g} from the base, and no tip is farther from it than {self._farthest:g}"
                raise Refusal(codes.GOAL_TOLERANCE_VIOLATED, words, message.id)
        return message

    def trajectory(self, message: GoalMessage, received: float) -> Trajectory:
        """Returns the trajectory of a goal, corrected by the tip bias.

        Args:
            message: the goal.
            received: time of arrival [UNIX s].

        Raises:
            Refusal: the goal is invalid; the message names the field.
        """
        arm, manipulator = self.arm, self.arm.manipulator
        scheduled = schedule(
            message, manipulator.dimension, arm.tolerance, arm.angle_tolerance, self.pace, received, manipulator
        )
        return scheduled.corrected(self._bias())

    def plan(
        self, trajectory: Trajectory, proceed: Callable[[], None], run: bool, seconds: float = PLANNING_TIME
    ) -> Planned:
        """Returns a plan from the arm's state; plans again if the arm or the obstacles changed meanwhile.

        Args:
            trajectory: the goal.
            proceed: called before each point; a Refusal that it raises ends the planning.
            run: whether the plan will be run.
            seconds: time for the searches of all points [s].

        Raises:
            Refusal: there is no plan.
        """
        for _ in range(TRIES):
            found = self._plan(trajectory, proceed, run, seconds)
            now = self._monitor.state
            moved = now is None or now.snapshot.outputs != found.state.snapshot.outputs
            if found.keep_out is self._solver.now()[1] and (found.keep_out.free or not moved):
                break
        return found

    def _plan(self, trajectory: Trajectory, proceed: Callable[[], None], run: bool, seconds: float) -> Planned:
        state = self._monitor.require(run)
        solver, keep_out = self._solver.now()
        previous = self._monitor.start(state, solver.manipulator)
        found = plan(solver, trajectory, previous, self.arm.settings.method, proceed, self.pace, seconds)
        self._check_size(found)
        collision = keep_out.first_collision(solver.manipulator.actuator_states(previous), stages_of(found))
        if collision is not None:  # checked again here, so that the executor need not ask
            raise Refusal(codes.GOAL_TOLERANCE_VIOLATED, f"the plan would collide: {collision}")
        return Planned(found, state, previous, solver, keep_out)

    def _check_size(self, found: Plan) -> None:
        """Checks that the executor accepts the size of a plan.

        Raises:
            Refusal: it has too many stages.
        """
        counts = [len(transition.stages) for transition in found.transitions]
        most = most_stages(len(self.arm.manipulator.actuators))
        if max(counts) > most or sum(counts) > MOST_PROGRAM_STAGES:
            raise Refusal(
                codes.INVALID_GOAL,
                f"the plan has {sum(counts)} stages, {max(counts)} to one point; at most {MOST_PROGRAM_STAGES} and"
                f" {most} are accepted: send fewer waypoints",
            )


def stages_of(found: Plan) -> Iterator[NDArray[np.uint8]]:
    """Yields the actuator states (A,) after each stage of a plan."""
    for transition in found.transitions:
        yield from transition.stages
