"""Ways around obstacles: transitions to a point whose cheapest configuration cannot be reached by clear stages."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.plans.points import TrajectoryPoint
from hyperbit.controller.motion.plans.transitions import PlannedTransition, TransitionPlanner
from hyperbit.controller.motion.stages.detours import Detour, Detours, Late, NoWay
from hyperbit.controller.motion.stages.pacing import Blocked
from hyperbit.controller.obstacles.distance import Index
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.clock import WALL, Clock
from hyperbit.controller.search.search_time import SearchTime
from hyperbit.controller.search.solution import EPSILON, Solution

ENDS = 4096  # most configurations of a point
TRY = 0.1  # [s] for one configuration, if no actuator may switch twice


class WayTime(NamedTuple):
    """When the search for a way ends."""

    began: float  # when the planning has begun, by the solver's clock [s]
    least: float  # until then at least
    allowed: SearchTime  # time from `began`
    proceed: Callable[[], bool]  # called between parts of the search; returns whether it must end soon
    clock: Clock = WALL

    def over(self, gap: float = np.inf) -> bool:
        """Returns whether the time is over, from the number of switches that may still be saved."""
        hurried, now = self.proceed(), self.clock.now()
        if gap < np.inf:
            return hurried or now > self.began + self.allowed.allowed(gap)
        return now > max(self.least, self.began + self.allowed.allowed(np.inf)) or (hurried and now > self.least)


class WaysAround:
    """Ways from one configuration (B,) to one point, whose cheapest solution is blocked; searched in `threads`."""

    def __init__(
        self,
        planner: TransitionPlanner,
        point: TrajectoryPoint,
        previous: Configuration,
        cheapest: Solution,
        threads: int = 1,
    ) -> None:
        self._planner, self._solver, self._point, self._previous = planner, planner.solver, point, previous
        self._cheapest, self._threads = cheapest, threads

    def find(self, blocked: Blocked, until: WayTime) -> PlannedTransition:
        """Returns the transition to another configuration, or a detour to one of all.

        Raises:
            Refusal: there is no way, or none was found in time; the message names what blocks the cheapest.
        """
        refusal = Refusal(Reason.NO_CLEAR_PATH, where=self._point.place, blocked=str(blocked))
        ends, complete = self._ends()
        if self._planner.pace.rest > 0:
            return self._once(ends, until, refusal)
        return self._detour(ends, complete, blocked, until, refusal)

    def _ends(self) -> tuple[Index, bool]:
        """Returns configurations (n, B) of the point by their cost, the cheapest first; whether these are all."""
        cheapest, solver, target = self._cheapest.configuration, self._solver, self._point.target
        if self._point.states is not None:
            return cheapest[None], True
        others, costs, complete = solver.candidates(target, self._previous, ENDS)
        found = [cheapest, *others[np.argsort(costs, kind="stable")]]
        return np.array(list({end.tobytes(): end for end in found}.values())), complete

    def _once(self, ends: Index, until: WayTime, refusal: Refusal) -> PlannedTransition:
        """Returns the first transition in which no actuator switches twice, because actuators must rest."""
        for end in ends:
            tried = until.clock.now() + TRY

            def late(tried: float = tried) -> bool:
                return until.over() or until.clock.now() > tried

            found = self._detours(end[None], complete=False, once=True).search(late)
            if isinstance(found, Detour) and (planned := self._by(found)) is not None:
                return planned
            if until.over():
                break
        raise refusal

    def _detour(
        self, ends: Index, complete: bool, blocked: Blocked, until: WayTime, refusal: Refusal
    ) -> PlannedTransition:
        """Returns the cheapest detour found; the gap decides how long it is searched after the first."""
        best, detours = None, self._detours(ends, complete=complete)
        late: Late = until.over
        while (found := detours.search(late)) is not None:
            if isinstance(found, NoWay):
                return best or self._reached(detours, found, blocked)
            planned = self._by(found)
            if planned is not None and (best is None or planned.solution.cost < best.solution.cost * (1 - EPSILON)):
                best = planned
                gap = (best.solution.cost - self._cheapest.bound) / self._solver.mean_weight

                def late(gap: float = gap) -> bool:
                    return until.over(gap)

        if best is None:
            raise refusal
        return best

    def _detours(self, ends: Index, *, complete: bool, once: bool = False) -> Detours:
        assert self._solver.clearance is not None
        parts = self._solver.clearance, self._previous, ends
        return Detours(*parts, complete=complete, once=once, threads=self._threads, clock=self._solver.clock)

    def _reached(self, detours: Detours, found: NoWay, blocked: Blocked) -> PlannedTransition:
        """Returns the transition to the cheapest configuration among all that can be reached."""
        reached = () if found.reached is None else found.reached
        solutions = [
            self._planner.solution_of(self._point, self._previous, each, self._cheapest.bound) for each in reached
        ]
        served = sorted((s for s in solutions if self._serves(s)), key=lambda solution: solution.cost)
        for solution in served:
            planned = self._by(Detour(detours.order_to(solution.configuration), solution.configuration))
            if planned is not None:
                return planned
        if served:
            raise Refusal(Reason.NO_CLEAR_PATH, where=self._point.place, blocked=str(blocked))
        raise Refusal(Reason.NO_WAY, where=self._point.place, proof=found.proof, blocked=str(blocked))

    def _serves(self, solution: Solution) -> bool:
        if self._point.states is None:
            return solution.within_tolerance
        return np.array_equal(solution.configuration, self._cheapest.configuration)

    def _by(self, detour: Detour) -> PlannedTransition | None:
        """Returns the transition by a detour; None if there is not enough time for its stages."""
        solution = self._planner.solution_of(self._point, self._previous, detour.end, self._cheapest.bound)
        try:
            return self._planner.transition(self._point, self._previous, solution, detour=detour.order)
        except (Blocked, Refusal):
            return None
