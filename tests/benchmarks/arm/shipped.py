"""Each arm in deploy: time and memory of mapping, and the results of each method for random goals."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.method import Method
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.benchmarks.harness import DEPLOY, CommandLine, median_and_99, show, timed, write_figures
from tests.benchmarks.solving import home, random_tips, solved_in_sequence

METHODS: tuple[Method, ...] = ("minimum-switch", "ipop-fewest-switches", "pop")


def measured(path: Path, number: int) -> dict[str, dict[str, Any]]:
    """Measures an arm on tips of random configurations, each from the previous goal's configuration; shows the table.

    Returns by method: shares within the tolerance and proven, mean and most switches, and the time of each goal [s].
    """
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
    solver = Solver(manipulator, densities, weights_of(arm))
    solver.prepare()
    goals = random_tips(manipulator, number)[:, : manipulator.dimension, 3]
    figures, rows = {}, []
    for method in METHODS:

        def solve(goal: NDArray[np.float64], previous: Configuration, method: Method = method) -> Solution:
            return solver.solve(solver.target(goal, arm.tolerance), previous, method)

        _, found = solved_in_sequence(solve, goals, home(manipulator))
        switches, times = [f.switches for f in found], [f.seconds for f in found]
        within = float(np.mean([f.within_tolerance for f in found]))
        proven = float(np.mean([f.certificate == "optimal" for f in found]))
        numbers = float(np.mean(switches)), max(switches)
        figures[method] = {"within": within, "proven": proven, "switches": numbers, "seconds": times}
        switched = f"{numbers[0]:.2f} / {numbers[1]}"
        rows.append((method, f"{within:.1%}", f"{proven:.0%}", switched, median_and_99(times)))
    show(head, ("method", "within", "proven", "switches, mean / most", "median / 99 % [ms]"), rows)
    return figures


def main() -> None:
    given = CommandLine(__doc__, goals=200).parse()
    write_figures(given.json, {path.stem: measured(path, given.goals) for path in sorted(DEPLOY.glob("*.yaml"))})


if __name__ == "__main__":
    main()
