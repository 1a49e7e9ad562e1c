"""Goals with orientation: results of each method for poses of random configurations. python -m tests.benchmarks.poses

Each goal is asked for from the configuration reached for the one before. Fewest switches are held to what the same
search proves when it is given more time, from the same configurations. With --busy deadlines and times are those of the
thread on its processor, so that other programs do not count.
"""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from controller.arm.arm import Arm, load
from controller.manipulator.frames import inverse
from controller.manipulator.manipulator import Configuration
from controller.search.solution import Solution
from controller.search.solver import Solver
from controller.search.target import SearchTarget
from controller.workspace.mapping import map_densities
from tests.benchmarks.methods import oriented_ipop

DEPLOY = Path(__file__).parents[2] / "deploy"
WARM, PROVING = 3, 2.0  # [s] for a proof
ORIENTED_PIXELS = 20_000

Solve = Callable[[NDArray[np.float64], Configuration], Solution]


@dataclass(frozen=True)
class Experiment:
    """An arm's file, how many goals, and the tolerances of position (in lengths of the arm, or its unit) and angle."""

    file: str
    goals: int
    tolerance: float
    turn: float
    relative: bool = False


EXPERIMENTS = (
    Experiment("planar16.yaml", 500, 0.005, 0.03),
    Experiment("platform8.yaml", 200, 0.01, math.radians(3.0), relative=True),
)


def traced(solve: Solve, goals: NDArray[np.float64], home: Configuration) -> tuple[list[Configuration], list[Solution]]:
    """Returns the start and the solution of each goal."""
    for goal in goals[:WARM]:
        solve(goal, home)
    before, found = [home], list[Solution]()
    for goal in goals:
        found.append(solve(goal, before[-1]))
        before.append(found[-1].configuration)
    return before[:-1], found


def oriented(arm: Arm, solver: Solver, tolerance: float, turn: float) -> Solve:
    """Returns IPOP on densities with orientation; it runs in Python, so its time is not comparable."""
    problem = oriented_ipop.prepare(arm.manipulator, solver.densities, ORIENTED_PIXELS, tolerance / turn)
    to_base = inverse(arm.manipulator.base)

    def solve(goal: NDArray[np.float64], previous: Configuration) -> Solution:
        target = SearchTarget(to_base @ goal, goal, arm.manipulator, tolerance, turn, tolerance / turn)
        return solver.described(
            oriented_ipop.solve(problem, target, previous), solver.target(goal, tolerance, turn), previous
        )

    return solve


def measured(experiment: Experiment, number: int, console: Console) -> None:
    """Measures one arm and prints the table."""
    arm = load(DEPLOY / experiment.file)
    m = arm.manipulator
    tolerance, turn = experiment.tolerance * (m.length if experiment.relative else 1.0), experiment.turn
    solver = Solver(m, map_densities(m, arm.pixel, arm.level_pixels), arm.weights())
    solver.prepare()
    count = min(number, experiment.goals)
    goals = m.tips(np.random.default_rng(1).integers(0, m.states, (count, len(m.states))))
    home = np.zeros(len(m.states), dtype=np.int64)
    began = time.perf_counter()
    by_orientation = oriented(arm, solver, tolerance, turn)
    mapping = time.perf_counter() - began
    ways: dict[str, Solve] = {
        "minimum-switch": lambda goal, previous: solver.solve(solver.target(goal, tolerance, turn), previous),
        "minimum-switch, position only": lambda goal, previous: solver.solve(solver.target(goal, tolerance), previous),
        "ipop-fewest-switches": lambda goal, previous: solver.solve(
            solver.target(goal, tolerance, turn), previous, "ipop-fewest-switches"
        ),
        "pop": lambda goal, previous: solver.solve(solver.target(goal, tolerance, turn), previous, "pop"),
        f"IPOP, densities with orientation (mapped in {mapping:.1f} s)": by_orientation,
    }
    title = f"{experiment.file}: {count} poses, tolerance {tolerance:.3g} and {turn:.3g} rad"
    table = Table("method", "within", "proven", "switches, mean / most", "median / 99 % / most [ms]", title=title)
    proofs = ""
    for name, solve in ways.items():
        before, found = traced(solve, goals, home)
        if name == "minimum-switch":
            proofs = proven(solver, tolerance, turn, goals, before, found)
        switches, times = [f.switches for f in found], 1e3 * np.array([f.seconds for f in found])
        spent = " / ".join(f"{t:.2f}" for t in (np.median(times), np.quantile(times, 0.99), times.max()))
        within, optimal = (
            np.mean([getattr(f, name) is True for f in found]) for name in ("within_tolerance", "optimal")
        )
        numbers = f"{np.mean(switches):.2f} / {max(switches)}"
        table.add_row(name, f"{within:.1%}", f"{optimal:.0%}", numbers, spent if times.any() else "")
    table.caption = proofs
    console.print(table)


def proven(
    solver: Solver,
    tolerance: float,
    turn: float,
    goals: NDArray[np.float64],
    before: list[Configuration],
    found: list[Solution],
) -> str:
    """Compares the found switches with the proven minimum."""
    own = least = known = 0
    for goal, previous, solution in zip(goals, before, found, strict=True):
        proof = solver.solve(solver.target(goal, tolerance, turn), previous, timeout=PROVING)
        if proof.optimal and solution.within_tolerance:
            own, least, known = own + solution.switches, least + proof.switches, known + 1
    ratio = f"{own / least:.3f}" if least else "-"
    return f"minimum-switch: {ratio} times the fewest, over the {known} of {len(goals)} proven in {PROVING:g} s each"


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=500)
    parser.add_argument("--busy", action="store_true", help="count the thread's own time, on a busy machine")
    given = parser.parse_args()
    if given.busy:
        time.perf_counter = time.thread_time
    for experiment in EXPERIMENTS:
        measured(experiment, given.goals, Console(width=120))


if __name__ == "__main__":
    main()
