"""A trajectory's plan: the configuration for each point, each searched from the one before, and the stages there."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration
from controller.motion.codes import GOAL_TOLERANCE_VIOLATED, INVALID_GOAL, Refusal
from controller.motion.pacing import Blocked, Infeasible, Pace, Staged
from controller.motion.sentences import out_of_reach, place
from controller.motion.stage_sequencer import DETOUR_TIME
from controller.motion.trajectory import Trajectory, upwards
from controller.motion.without_search import fixed, held
from controller.obstacles.sweep import Sweep, sweep_of
from controller.search.method import Method
from controller.search.solution import Certificate, Solution, certificate, proof
from controller.search.solver import DEADLINE, Solver

# [s] for the whole of a trajectory: the arm is to begin soon. First answers are kept time for, and given when the rest
# is over; how far the tip strays there is left to looking ahead.
PLANNING_TIME, FIRST_ANSWER = 0.03, 0.0002

ASIDE, OTHERS = 0.25, 32  # [s] for other configurations where there is no way to the cheapest, and how many


AT_ONCE = Pace(0.0)


@dataclass(frozen=True, eq=False)
class Plan:
    """What will be done.

    Attributes:
        trajectory: the goal.
        solutions: one for each point.
        transitions: how each point's configuration is switched to from the one before.
        bound: proven: no plan costs less; 0 if nothing is proven.
    """

    trajectory: Trajectory
    solutions: tuple[Solution, ...]
    transitions: tuple[Staged, ...]
    bound: float = 0.0

    @property
    def actuator_states(self) -> NDArray[np.uint8]:
        """Of each point's configuration, shape (n, A)."""
        return np.array([transition.stages[-1] for transition in self.transitions])

    @property
    def switches(self) -> int:
        """Actuators that switch, all points together."""
        return sum(solution.switches for solution in self.solutions)

    @property
    def cost(self) -> float:
        """Weighted number of switches, all points together."""
        return sum(solution.cost for solution in self.solutions)

    @property
    def certificate(self) -> Certificate:
        """What is proven of the cost of the whole plan, see Solution.certificate."""
        return certificate(all(s.within_tolerance for s in self.solutions), self.bound, self.cost)

    def proof(self) -> dict[str, str | bool | float | None]:
        """Returns what is proven of the cost of the whole plan, as fields for JSON."""
        return proof(self.certificate, self.bound)

    def proven(self, bound: float) -> "Plan":
        """Returns the plan with what else is proven."""
        return replace(self, bound=max(self.bound, bound))

    def improved(
        self,
        solver: Solver,
        pace: Pace,
        first: int,
        configurations: Sequence[Configuration],
        previous: Configuration | None = None,
    ) -> "Plan":
        """Returns the plan with other configurations from point `first` on; the rest stays as it is.

        So does a part that would miss a point, or whose transitions would not fit in the time there is. The
        configuration before the first point, shape (B,), is needed only if that changes, too.
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
                transitions[k] = staged(solver, self.trajectory, before, solutions[k], k, pace)
                continue
            available = float(times[k] - times[k - 1])
            transitions[k] = pace.staged(
                solver.manipulator, before, configuration, available, sweep=sweep_for(solver), patience=0.0
            )
        return Plan(self.trajectory, tuple(solutions), tuple(transitions), self.bound)


def plan(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    method: Method,
    proceed: Callable[[], None] = lambda: None,
    pace: Pace = AT_ONCE,
    seconds: float = PLANNING_TIME,
) -> Plan:
    """Returns the plan of a trajectory.

    Args:
        solver: of the arm.
        trajectory: what is asked for.
        previous: configuration that the arm is in, shape (B,).
        method: the algorithm.
        proceed: called before each point; a Refusal it raises ends the planning.
        pace: of the transitions.
        seconds: time for the searches of all points [s].

    Raises:
        Refusal: a point is out of reach, the message has the nearest point found; there is no way to it that touches
            nothing, or too little time; or the arm touches something where it is.
    """
    if solver.clearance is not None and (where := solver.clearance.where(previous)) is not None:
        raise Refusal(INVALID_GOAL, f"the arm may not move from where it stands: {where}")
    solutions, transitions = list[Solution](), list[Staged]()
    reserved = min(FIRST_ANSWER * len(trajectory.times), 0.8 * seconds)
    until = time.perf_counter() + seconds - reserved
    longest = max(DEADLINE, seconds / len(trajectory.times))
    for k, position in enumerate(trajectory.positions):
        proceed()
        goal, tolerance, turn = trajectory.goal(k), float(trajectory.tolerances[k]), float(trajectory.turns[k])
        if trajectory.between(k) and (same := held(solutions[-1], position, tolerance)) is not None:
            transitions.append(replace(transitions[-1], stages=transitions[-1].stages[-1:], deviation_source=0.0))
            solutions.append(same)
            continue
        left = max(until - time.perf_counter(), 0.0)
        with_deviation = left > 0 or method != "minimum-switch"
        if k in trajectory.fixed:
            solution = fixed(solver, trajectory, previous, k)
            try:
                transitions.append(staged(solver, trajectory, previous, solution, k, pace, with_deviation, DETOUR_TIME))
            except Blocked as blocked:
                what = f"no way to it without touching anything: {blocked}"
                raise Refusal(GOAL_TOLERANCE_VIOLATED, f"{place(trajectory, k)}: {what}") from None
            solutions.append(solution)
            previous = solution.configuration
            continue
        solution = solver.solve(goal, previous, tolerance, method, min(longest, left), turn)
        if not solution.within_tolerance:
            raise Refusal(GOAL_TOLERANCE_VIOLATED, out_of_reach(trajectory, k, solution))
        try:
            transition = staged(solver, trajectory, previous, solution, k, pace, with_deviation)
        except Blocked as blocked:
            solution, transition = aside(solver, trajectory, previous, solution, k, pace, blocked)
        except Refusal:  # perhaps a search with more time finds what switches less
            solution = solver.solve(goal, previous, tolerance, method, angle_tolerance=turn)
            try:
                transition = staged(solver, trajectory, previous, solution, k, pace)
            except Blocked as blocked:
                solution, transition = aside(solver, trajectory, previous, solution, k, pace, blocked)
        solutions.append(solution)
        transitions.append(transition)
        previous = solution.configuration
    return Plan(trajectory, tuple(solutions), tuple(transitions), solutions[0].bound)


def sweep_for(solver: Solver) -> Sweep | None:
    """Returns what tells whether transitions touch anything; None where there is nothing to touch."""
    return None if solver.clearance is None or solver.clearance.free else sweep_of(solver.clearance)


def aside(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    cheapest: Solution,
    k: int,
    pace: Pace,
    blocked: Blocked,
) -> tuple[Solution, Staged]:
    """Returns another configuration for point k, or a roundabout way, where there is no plain one to the cheapest.

    Raises:
        Refusal: none is found in the time for that; the message has what is in the way to the cheapest.
    """
    goal, tolerance, turn = trajectory.goal(k), float(trajectory.tolerances[k]), float(trajectory.turns[k])
    until = time.perf_counter() + ASIDE
    others, costs = solver.candidates(goal, previous, tolerance, OTHERS, turn)
    methods: tuple[Method, ...] = ("ipop-fewest-switches", "pop")
    ranked = [others[n] for n in np.argsort(costs, kind="stable")]
    ranked += [
        solver.solve(goal, previous, tolerance, method, angle_tolerance=turn).configuration for method in methods
    ]
    distinct = {c.tobytes(): c for c in (cheapest.configuration, *ranked)}
    found = [solver.described(c, goal, previous, tolerance, turn) for c in distinct.values()]
    served = [solution for solution in found if solution.within_tolerance]
    for patience, solutions in ((0.0, served[1:]), (DETOUR_TIME, served)):  # plain ways first
        for solution in solutions:
            if time.perf_counter() > until:
                break
            try:
                transition = staged(solver, trajectory, previous, solution, k, pace, patience=patience)
            except (Blocked, Refusal):
                continue
            rows = np.vstack([solver.manipulator.actuator_states(previous), transition.stages])
            switches = int(np.count_nonzero(np.diff(rows.astype(int), axis=0)))
            return replace(solution, switches=switches), transition
    what = f"no way to it without touching anything: {blocked}"
    raise Refusal(GOAL_TOLERANCE_VIOLATED, f"{place(trajectory, k)}: {what}") from None


def staged(
    solver: Solver,
    trajectory: Trajectory,
    previous: Configuration,
    solution: Solution,
    k: int,
    pace: Pace,
    with_deviation: bool = True,
    patience: float = 0.0,
) -> Staged:
    """Returns the transition to point k; the first is late where there is too little time for it.

    Raises:
        Refusal: the time from point k - 1 is too short.
        Blocked: something is in the way.
    """
    if k > 0:
        available: float | None = float(trajectory.times[k] - trajectory.times[k - 1])
    elif trajectory.stamp is not None:
        left = trajectory.stamp + float(trajectory.times[0]) - time.time()
        available = max(left, pace.needed(solution.switches))
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
