"""The plan of a trajectory: a configuration for each point, and the stages of each transition."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import Infeasible, Staged
from hyperbit.controller.motion.trajectory import Trajectory
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.solution import Certificate, Solution, certificate, gap, proof


@dataclass(frozen=True, eq=False)
class TrajectoryPlan:
    """A planned trajectory."""

    trajectory: Trajectory  # the goal
    solutions: tuple[Solution, ...]  # one for each point; switches, cost and certificate are those of its transition
    transitions: tuple[Staged, ...]  # to each point's configuration from the one before
    bound: float = 0.0  # proven lower bound of the cost of any plan from this start; 0 if nothing is proven

    @property
    def actuator_states(self) -> NDArray[np.uint8]:
        """Actuator states at each point, shape (n, A)."""
        return np.array([transition.stages[-1] for transition in self.transitions])

    @property
    def switches(self) -> int:
        return sum(solution.switches for solution in self.solutions)

    @property
    def cost(self) -> float:
        return sum(solution.cost for solution in self.solutions)

    @property
    def certificate(self) -> Certificate:
        return certificate(all(s.within_tolerance for s in self.solutions), self.bound, self.cost)

    def proof(self) -> dict[str, Any]:
        """Returns the certificate of the whole plan's cost, as fields for JSON."""
        return proof(self.certificate, self.bound)

    @property
    def gap(self) -> float | None:
        """Share by which the cost exceeds its lower bound; None if nothing is proven."""
        return gap(self.certificate, self.bound, self.cost)

    def proven(self, bound: float) -> "TrajectoryPlan":
        """Returns the plan with a lower bound, if that is greater than the present one."""
        bound, solutions = max(self.bound, bound), self.solutions
        if len(solutions) == 1:
            solutions = (replace(solutions[0], bound=bound),)
        return replace(self, solutions=solutions, bound=bound)

    def improved(
        self,
        planner: TransitionPlanner,
        first: int,
        configurations: Sequence[Configuration],
        previous: Configuration | None = None,
    ) -> "TrajectoryPlan":
        """Returns the plan with other configurations (B,) from point `first` on.

        A part is left as it was if it would miss a point, or if its transitions would not fit into the time.
        `previous` (B,) is the configuration before the first point, needed only if `first` is 0.
        """
        try:
            return self._changed(planner, first, configurations, previous)
        except (Infeasible, Refusal):
            half = len(configurations) // 2
            if half == 0:
                return self
            beginning = self.improved(planner, first, configurations[:half], previous)
            return beginning.improved(planner, first + half, configurations[half:])

    def _changed(
        self,
        planner: TransitionPlanner,
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
            bound, point = self.solutions[k].bound if same_start else 0.0, planner.points[k]
            solution = planner.solution_of(point, before, configuration, bound)
            if not solution.within_tolerance:
                raise Infeasible(f"{solution.error:.4f} from point {k}")
            solutions[k], transitions[k] = planner.transition(point, before, solution)
        return TrajectoryPlan(self.trajectory, tuple(solutions), tuple(transitions), self.bound)
