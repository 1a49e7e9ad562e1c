"""The plan of a trajectory: a configuration for each point, and the stages of each transition."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.pacing import Blocked, Infeasible, Pace, Staged
from controller.motion.trajectory import Trajectory, upwards
from controller.obstacles.sweep import Sweep, sweep_of
from controller.search.solution import Certificate, Solution, certificate, proof
from controller.search.solver import Solver


@dataclass(frozen=True, eq=False)
class Plan:
    """A planned trajectory.

    Attributes:
        trajectory: the goal.
        solutions: one for each point.
        transitions: to each point's configuration from the one before.
        bound: proven lower bound of the cost of any plan; 0 if nothing is proven.
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

    def proven(self, bound: float) -> "Plan":
        """Returns the plan with a lower bound, if that is greater than the present one."""
        return replace(self, bound=max(self.bound, bound))

    def improved(
        self,
        solver: Solver,
        pace: Pace,
        first: int,
        configurations: Sequence[Configuration],
        previous: Configuration | None = None,
    ) -> "Plan":
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
    ) -> "Plan":
        solutions, transitions, times = list(self.solutions), list(self.transitions), self.trajectory.times
        end = first + len(configurations)
        chosen = [*configurations, *(s.configuration for s in self.solutions[end : end + 1])]
        for k, configuration in enumerate(chosen, first):
            goal, before = self.trajectory.goal(k), solutions[k - 1].configuration if k else previous
            if before is None:
                raise ValueError("the configuration before the first point is needed")
            tolerance, turn = float(self.trajectory.tolerances[k]), float(self.trajectory.turns[k])
            solutions[k] = solver.described(configuration, goal, before, tolerance, turn)
            if not solutions[k].within_tolerance:
                raise Infeasible(f"{solutions[k].error:.4f} from point {k}")
            if k == 0:
                transitions[k] = transition_to(solver, self.trajectory, before, solutions[k], k, pace)
                continue
            available = float(times[k] - times[k - 1])
            transitions[k] = pace.staged(
                solver.manipulator, before, configuration, available, sweep=sweep_for(solver), patience=0.0
            )
        return Plan(self.trajectory, tuple(solutions), tuple(transitions), self.bound)


def transition_to(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    solution: Solution,
    k: int,
    pace: Pace,
    with_deviation: bool = True,
    patience: float = 0.0,
) -> Staged:
    """Returns the transition to point k. The first transition may be late; the others must fit into their time.

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
        configuration, sweep = solution.configuration, sweep_for(solver)
        return pace.staged(solver.manipulator, previous, configuration, available, with_deviation, sweep, patience)
    except Blocked:
        raise
    except Infeasible as error:
        number = trajectory.next(k)
        if number == 0:
            raise Refusal(INVALID_GOAL, f"waypoints[0]: {available:.3g} s, {error}") from None
        where, whole = f"waypoints[{number - 1}] to waypoints[{number}]", ""
        parts = int(trajectory.waypoints[number] - trajectory.waypoints[number - 1])
        if parts > 1:
            where += f", one of {parts} parts"
            whole = f", and the line {upwards(parts * pace.needed(solution.switches)):g} s"
        raise Refusal(INVALID_GOAL, f"{where}: {available:.3g} s, {error}{whole}") from None


def sweep_for(solver: Solver) -> Sweep | None:
    """Returns the swept checks of transitions; None if there is nothing to collide with."""
    return None if solver.clearance is None or solver.clearance.free else sweep_of(solver.clearance)
