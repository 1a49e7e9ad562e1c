"""The plan of a trajectory: a configuration for each point, and the stages of each transition."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion.stages.pacing import Blocked, Infeasible, Pace, Staged
from controller.motion.stages.restaging import restage
from controller.motion.trajectory import Trajectory, upwards
from controller.obstacles.keep_out import KeepOutSet
from controller.obstacles.sweep import Sweep, sweep_of
from controller.refusals.reasons import Reason
from controller.refusals.refusal import Refusal
from controller.search.solution import Certificate, Solution, certificate, proof
from controller.search.solver import Solver


@dataclass(frozen=True, eq=False)
class TrajectoryPlan:
    """A planned trajectory.

    Attributes:
        trajectory: the goal.
        solutions: one for each point; switches, cost and certificate are those of its transition, see `transition_to`.
        transitions: to each point's configuration from the one before.
        bound: proven lower bound of the cost of any plan from this start; 0 if nothing is proven.
    """

    trajectory: Trajectory
    solutions: tuple[Solution, ...]
    transitions: tuple[Staged, ...]
    bound: float = 0.0

    @property
    def actuator_states(self) -> NDArray[np.uint8]:
        """Actuator states at each point, shape (n, A)."""
        return np.array([transition.stages[-1] for transition in self.transitions])

    @property
    def switches(self) -> int:
        """Number of switches over all points."""
        return sum(solution.switches for solution in self.solutions)

    @property
    def cost(self) -> float:
        """Weighted number of switches over all points."""
        return sum(solution.cost for solution in self.solutions)

    @property
    def certificate(self) -> Certificate:
        """The certificate of the whole plan's cost; see Solution.certificate."""
        return certificate(all(s.within_tolerance for s in self.solutions), self.bound, self.cost)

    def proof(self) -> dict[str, str | bool | float | None]:
        """Returns the certificate of the whole plan's cost, as fields for JSON."""
        return proof(self.certificate, self.bound)

    def proven(self, bound: float) -> "TrajectoryPlan":
        """Returns the plan with a lower bound, if that is greater than the present one."""
        bound, solutions = max(self.bound, bound), self.solutions
        if len(solutions) == 1:
            solutions = (replace(solutions[0], bound=bound),)
        return replace(self, solutions=solutions, bound=bound)

    def improved(
        self,
        solver: Solver,
        pace: Pace,
        first: int,
        configurations: Sequence[Configuration],
        previous: Configuration | None = None,
    ) -> "TrajectoryPlan":
        """Returns the plan with other configurations from point `first` on.

        A part is left as it was if it would miss a point, or if its transitions would not fit into the time. The
        configuration before the first point, shape (B,), is needed only if the first point's configuration changes.
        """
        try:
            return self._changed(solver, pace, first, configurations, previous)
        except (Infeasible, Refusal):
            half = len(configurations) // 2
            if half == 0:
                return self
            beginning = self.improved(solver, pace, first, configurations[:half], previous)
            return beginning.improved(solver, pace, first + half, configurations[half:])

    def _changed(
        self,
        solver: Solver,
        pace: Pace,
        first: int,
        configurations: Sequence[Configuration],
        previous: Configuration | None,
    ) -> "TrajectoryPlan":
        solutions, transitions = list(self.solutions), list(self.transitions)
        end = first + len(configurations)
        chosen = [*configurations, *(s.configuration for s in self.solutions[end : end + 1])]
        for k, configuration in enumerate(chosen, first):
            before = solutions[k - 1].configuration if k else previous
            if before is None:
                raise ValueError("the configuration before the first point is needed")
            same_start = k == 0 or np.array_equal(before, self.solutions[k - 1].configuration)
            bound = self.solutions[k].bound if same_start else 0.0
            solution = solution_of(solver, self.trajectory, before, configuration, k, bound)
            if not solution.within_tolerance:
                raise Infeasible(f"{solution.error:.4f} from point {k}")
            solutions[k], transitions[k] = transition_to(solver, self.trajectory, before, solution, k, pace)
        return TrajectoryPlan(self.trajectory, tuple(solutions), tuple(transitions), self.bound)


def solution_of(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    configuration: Configuration,
    k: int,
    bound: float = 0.0,
) -> Solution:
    """Returns a configuration (B,) as the solution of point k.

    Args:
        solver: of the arm.
        trajectory: the goal.
        previous: configuration before, shape (B,).
        configuration: to describe.
        k: index of the point.
        bound: proven lower bound of the cost of any configuration of the point. A point that is given as a
            configuration needs none: at least the actuators that differ must switch.
    """
    tolerance, turn = float(trajectory.tolerances[k]), float(trajectory.turns[k])
    found = solver.described(configuration, trajectory.goal(k), previous, tolerance, turn)
    return replace(found, bound=found.cost if k in trajectory.fixed else min(bound, found.cost))


def transition_to(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    solution: Solution,
    k: int,
    pace: Pace,
    with_deviation: bool = True,
    patience: float = 0.0,
) -> tuple[Solution, Staged]:
    """Returns the solution of point k with switches and cost of its transition, and the transition.

    A detour switches more actuators than differ between the configurations. The bound of a solution holds for detours,
    too. The first transition may be late; the others must fit into their time.

    Args:
        solver: of the arm.
        trajectory: the goal.
        previous: configuration before, shape (B,).
        solution: of point k, from `previous`.
        k: index of the point.
        pace: of the transitions.
        with_deviation: compute the deviation, also without an inrush bound.
        patience: time to search for a detour [s].

    Raises:
        Refusal: the time from point k - 1 is too short.
        Blocked: no collision-free stages were found.
    """
    if k > 0:
        available: float | None = float(trajectory.times[k] - trajectory.times[k - 1])
    elif trajectory.stamp is not None:
        remaining = trajectory.stamp + float(trajectory.times[0]) - time.time()
        available = max(remaining, pace.needed(solution.switches))
    else:
        available = None
    try:
        after, sweep = solution.configuration, sweep_for(solver)
        staged = pace.staged(solver.manipulator, previous, after, available, with_deviation, sweep, patience)
    except Blocked:
        raise
    except Infeasible as error:
        number = trajectory.next(k)
        if number == 0:
            raise Refusal(
                Reason.TIME_TOO_SHORT, where="waypoints[0]", available=f"{available:.3g}", needed=str(error)
            ) from None
        where, whole = f"waypoints[{number - 1}] to waypoints[{number}]", ""
        parts = int(trajectory.waypoints[number] - trajectory.waypoints[number - 1])
        if parts > 1:
            where += f", one of {parts} parts"
            whole = f", and the line {upwards(parts * pace.needed(solution.switches)):g} s"
        raise Refusal(
            Reason.TIME_TOO_SHORT, where=where, available=f"{available:.3g}", needed=f"{error}{whole}"
        ) from None
    if len(staged.stages) == 1:  # no actuator switches twice
        return solution, staged
    counts = staged.switches_from(solver.manipulator.actuator_states(previous))
    return replace(solution, switches=int(counts.sum()), cost=solver.cost_of(counts)), staged


def first_transition(
    manipulator: Manipulator,
    pace: Pace,
    keep_out: KeepOutSet,
    commanded: NDArray[np.uint8],
    planned: Staged,
    proceed: Callable[[], None],
) -> Staged:
    """Returns the transition to the first point of a plan from other actuator states than planned.

    Planned stages among obstacles stay if they are clear from there, because they may contain detours.

    Args:
        manipulator: the whole arm.
        pace: of the transitions.
        keep_out: the obstacles.
        commanded: actuator states before, of a configuration, shape (A,).
        planned: the transition of the plan.
        proceed: called before each check of a stage; it raises if the transition is no longer needed.

    Raises:
        Refusal: the stages would collide.
    """
    most = pace.inrush or len(commanded)
    if not keep_out.free:
        rows = np.vstack([commanded, planned.stages])
        fits = np.count_nonzero(rows[1:] != rows[:-1], axis=1).max() <= most
        if fits and keep_out.first_collision(commanded, planned.stages, proceed) is None:
            return planned
    stages = restage(manipulator, commanded, planned.stages, most)
    if (collision := keep_out.first_collision(commanded, stages, proceed)) is not None:
        raise Refusal(Reason.START_COLLIDES, collision=collision)
    return planned if np.array_equal(stages, planned.stages) else Staged(stages, None, planned.strict)


def sweep_for(solver: Solver) -> Sweep | None:
    """Returns the swept checks of transitions; None if there is nothing to collide with."""
    return None if solver.clearance is None or solver.clearance.free else sweep_of(solver.clearance)
