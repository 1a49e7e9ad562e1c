"""Solvers with their tables, random goals, and methods that solve the same goals one after another."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.search.method import Method
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities
from tests.benchmarks.harness import joined, no_collection, percentiles, show

METHODS: tuple[Method, ...] = ("minimum-switch", "ipop-fewest-switches", "pop")
POSE = 0.005, 0.03  # tolerances of poses of the paper's arm
WARM = 3  # goals before those that count
FEW = 10.0  # configurations that are expected within the tolerance in a sparse place, at most
COLUMNS = ("within", "proven", "switches, mean / most", "median / 99 % / most [ms]")

Goals = NDArray[np.float64]
Solve = Callable[[NDArray[np.float64], Configuration], Solution]


def ready_solver(arm: Arm) -> Solver:
    manipulator = arm.manipulator
    solver = Solver(manipulator, map_densities(manipulator, arm.pixel, arm.level_pixels), weights_of(arm))
    solver.prepare()
    return solver


def by(solver: Solver, method: Method, tolerance: float, turn: float = np.inf, **options: Any) -> Solve:
    """Returns the search for a goal with these tolerances."""
    return lambda goal, previous: solver.solve(solver.target(goal, tolerance, turn), previous, method, **options)


def home(manipulator: Manipulator) -> Configuration:
    return np.zeros(len(manipulator.states), dtype=np.int64)


def random_frames(manipulator: Manipulator, count: int, seed: int = 1) -> Goals:
    """Returns the tips of uniformly random configurations, shape (count, 4, 4)."""
    configurations = np.random.default_rng(seed).integers(0, manipulator.states, (count, len(manipulator.states)))
    return manipulator.tips(configurations)


def random_tips(manipulator: Manipulator, count: int, seed: int = 1) -> Goals:
    """Returns their positions, shape (count, 2) or (count, 3)."""
    return random_frames(manipulator, count, seed)[:, : manipulator.dimension, 3]


def sparse_tips(manipulator: Manipulator, densities: Densities, tolerance: float, count: int) -> Goals:
    """Returns tips of a planar arm at the edge of its workspace, in pixels with few points, shape (count, 2)."""
    values = densities.level(0)[0]
    share = np.pi * tolerance**2 / densities.pixels[0] ** 2
    expected = np.where(values >= 0, np.exp(values.astype(float)) * share, 0.0)
    y, x = np.nonzero((expected > 0) & (expected <= FEW))
    centres = densities.references[0, :2] + densities.pixels[0] * np.column_stack((x, y))
    solve, start = by(Solver(manipulator, densities), "pop", tolerance), home(manipulator)
    return np.array([solve(goal, start).tip[:2, 3] for goal in np.random.default_rng(2).choice(centres, count)])


@dataclass(frozen=True, eq=False)
class Trace:
    """Goals that were solved: the configuration before each, and its solution."""

    before: list[Configuration] = field(default_factory=list)
    found: list[Solution] = field(default_factory=list)

    @property
    def seconds(self) -> list[float]:
        return [solution.seconds for solution in self.found]

    @property
    def reached(self) -> list[Solution]:
        return [solution for solution in self.found if solution.within_tolerance]

    def figures(self) -> dict[str, float]:
        switches = [solution.switches for solution in self.found]
        return {
            "within": len(self.reached) / len(self.found),
            "proven": float(np.mean([solution.certificate == "optimal" for solution in self.found])),
            "switches": float(np.mean(switches)),
            "most": max(switches),
        } | percentiles(self.seconds)

    def cells(self) -> tuple[str, ...]:
        own = self.figures()
        switches = f"{own['switches']:.2f} / {own['most']}"
        return f"{own['within']:.1%}", f"{own['proven']:.1%}", switches, joined(self.seconds, "p50", "p99", "worst")


def traced(solve: Solve, goals: Goals, start: Configuration, before: list[Configuration] | None = None) -> Trace:
    """Solves goals, each from the configuration reached for the goal before, or from given ones.

    Args:
        goals: the first `WARM` are also solved before, without being counted.
    """
    for goal in goals[:WARM]:
        solve(goal, start)
    trace, own = Trace(), start
    with no_collection():
        for k, goal in enumerate(goals):
            trace.before.append(own if before is None else before[k])
            trace.found.append(solve(goal, trace.before[-1]))
            own = trace.found[-1].configuration if trace.found[-1].within_tolerance else trace.before[-1]
    return trace


def compared(title: str, traces: dict[str, Trace]) -> dict[str, dict[str, float]]:
    """Shows a row for each trace; returns the figures."""
    show(title, ("", *COLUMNS), [(name, *trace.cells()) for name, trace in traces.items()])
    return {name: trace.figures() for name, trace in traces.items()}
