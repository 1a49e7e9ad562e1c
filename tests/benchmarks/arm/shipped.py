"""Each arm in deploy: time and memory of mapping, and the results of each method for random goals."""

import tracemalloc
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hyperbit.controller.arm.arm import load
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.method import Method
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.benchmarks.harness import DEPLOY, CommandLine, median_and_99, timed, write_figures
from tests.benchmarks.solving import home, random_tips, solved_in_sequence

METHODS: tuple[Method, ...] = ("minimum-switch", "ipop-fewest-switches", "pop")


@dataclass(frozen=True, eq=False)
class Row:
    """One method on one arm: share within the tolerance and proven, mean and most switches, time of each goal [s]."""

    method: str
    within: float
    proven: float
    switches: tuple[float, int]
    seconds: list[float]


def measured(path: Path, number: int) -> tuple[str, list[Row]]:
    arm = load(path)
    manipulator = arm.manipulator
    map_densities(manipulator, manipulator.length / 20, 1_000)  # loads the kernels
    tracemalloc.start()
    densities, seconds = timed(lambda: map_densities(manipulator, arm.pixel, arm.level_pixels))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    head = (
        f"{arm.settings.name}: length {manipulator.length:.3g}, tolerance {arm.tolerance:g}; mapped in {seconds:.2f} s,"
        f" {densities.values.nbytes / 1e6:.1f} MB, pixel {densities.pixels.min():.2g} to {densities.pixels.max():.2g},"
        f" {most / 1e6:.0f} MB on the way"
    )
    solver = Solver(manipulator, densities, arm.weights())
    solver.prepare()
    goals = random_tips(manipulator, number)[:, : manipulator.dimension, 3]
    rows = []
    for method in METHODS:

        def solve(goal: NDArray[np.float64], previous: Configuration, method: Method = method) -> Solution:
            return solver.solve(solver.target(goal, arm.tolerance), previous, method)

        _, found = solved_in_sequence(solve, goals, home(manipulator))
        switches, times = [f.switches for f in found], [f.seconds for f in found]
        within, proven = (
            np.mean([f.within_tolerance for f in found]),
            np.mean([f.certificate == "optimal" for f in found]),
        )
        rows.append(Row(method, float(within), float(proven), (float(np.mean(switches)), max(switches)), times))
    return head, rows


def main() -> None:
    given = CommandLine(__doc__, goals=200).parse()
    figures = {}
    console = Console(width=120)
    for path in sorted(DEPLOY.glob("*.yaml")):
        head, rows = measured(path, given.goals)
        table = Table(
            "method",
            "within",
            "proven",
            "switches, mean / most",
            "median / 99 % [ms]",
            title=head,
            title_justify="left",
        )
        for r in rows:
            switches = f"{r.switches[0]:.2f} / {r.switches[1]}"
            table.add_row(r.method, f"{r.within:.1%}", f"{r.proven:.0%}", switches, median_and_99(r.seconds))
        figures[path.stem] = rows
        console.print(table)
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()
