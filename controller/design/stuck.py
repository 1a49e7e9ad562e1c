"""Which targets an arm still reaches while one actuator is stuck in one of its states.

Each configuration that reaches a target is a witness for the states of all its actuators. Searches from random starts
find most pairs of actuator and state. Searches of the arm with one locked actuator decide the rest.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.design.merit import Effort, Judged, Searcher, Target, searcher_of
from hyperbit.controller.manipulator.locked import lock_actuators, none_locked, transferred
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles
from hyperbit.controller.search.enumeration import Enumeration
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.target import SearchTarget

Flags = NDArray[np.bool_]

STARTS = 24  # random starts for a target
BATCH = 1 << 12  # configurations of a collision check


class Witnesses(NamedTuple):
    """Which targets are reached with an actuator in a state: `seen`, shape (T, A, 2)."""

    searcher: Searcher
    targets: Sequence[Target]
    seen: Flags

    def add(self, target: int, configurations: NDArray[np.int64]) -> None:
        """Adds configurations (n, B) that reach a target."""
        states = self.searcher.solver.manipulator.actuator_states(configurations)
        self.seen[target, :, 0] |= (states == 0).any(axis=0)
        self.seen[target, :, 1] |= (states == 1).any(axis=0)

    @property
    def share(self) -> float:
        """Weighted share of targets, actuators and states that are reached."""
        weights = np.array([target.weight for target in self.targets])
        return float(weights @ self.seen.mean(axis=(1, 2)) / weights.sum())


def witnesses(searcher: Searcher, targets: Sequence[Target], solutions: Sequence[Solution | None]) -> Witnesses:
    """Returns what the solutions of targets witness, and searches by IPOP from random starts.

    Of an arm that is listed whole, each configuration is a witness.
    """
    solver, chain = searcher.solver, searcher.solver.manipulator
    found = Witnesses(searcher, targets, np.zeros((len(targets), len(chain.actuators), 2), dtype=bool))
    starts = np.random.default_rng(0).integers(0, chain.states, (STARTS, len(chain.modules)))
    for t, solution in enumerate(solutions):
        if solution is None or not solution.within_tolerance:
            continue
        goal = searcher.target(targets[t])
        if solver.enumeration is not None:
            for rows in listed(searcher, solver.enumeration, goal):
                found.add(t, rows)
            continue
        found.add(t, solution.configuration[None])
        for start in starts:
            other = solver.solve(goal, start, "ipop-fewest-switches")
            if other.within_tolerance:
                found.add(t, other.configuration[None])
    return found


def listed(searcher: Searcher, every: Enumeration, goal: SearchTarget) -> Iterator[NDArray[np.int64]]:
    """Yields the clear configurations (n, B) within the tolerances of a goal."""
    rows, clearance = every.configurations[every.met(goal)], searcher.solver.clearance
    for first in range(0, len(rows), BATCH):
        part = rows[first : first + BATCH]
        yield part if clearance is None else part[~clearance.blocked(part)]


def decide(found: Witnesses, own: Judged, obstacles: Obstacles = NONE, *, effort: Effort) -> None:
    """Searches each target that has no witness for an actuator in a state, with this actuator locked."""
    searcher, chain = found.searcher, own.manipulator
    reached = np.flatnonzero(found.seen.any(axis=(1, 2)))
    if searcher.solver.enumeration is not None:
        return
    for actuator in range(len(chain.actuators)):
        for state in (0, 1):
            open_targets = [t for t in reached.tolist() if not found.seen[t, actuator, state]]
            if open_targets and (locked := locked_searcher(found, own, obstacles, actuator, state)) is not None:
                for t in open_targets:
                    decide_one(found, locked, t, effort)


def locked_searcher(found: Witnesses, own: Judged, obstacles: Obstacles, actuator: int, state: int) -> Searcher | None:
    """Returns a searcher of the arm with an actuator locked in a state; None if a module has no such state."""
    held = none_locked(own.manipulator)
    held[actuator] = state
    try:
        reduced = lock_actuators(own.manipulator, held)
    except ValueError:
        return None
    return searcher_of(own._replace(manipulator=reduced), obstacles, found.searcher.solver.densities)


def decide_one(found: Witnesses, locked: Searcher, target: int, effort: Effort) -> None:
    """Searches a target with a locked actuator, and adds the configuration."""
    goal = locked.target(found.targets[target])
    solution = locked.solver.solve(goal, locked.home, timeout=effort.allowed)
    if solution.within_tolerance:
        whole: Configuration = transferred(
            solution.configuration, locked.solver.manipulator, found.searcher.solver.manipulator
        )
        found.add(target, whole[None])
