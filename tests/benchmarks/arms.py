"""Each arm in deploy: time and memory of mapping, and the results of each method for random goals."""

import argparse
import time
import tracemalloc
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from controller.arm.arm import load
from controller.search.method import Method
from controller.search.solver import Solver
from controller.workspace.mapping import map_densities

DEPLOY = Path(__file__).parents[2] / "deploy"
METHODS: tuple[Method, ...] = ("minimum-switch", "ipop-fewest-switches", "pop")
WARM = 3


@dataclass(frozen=True, eq=False)
class Row:
    """One method on one arm: share within the tolerance and proven, mean and most switches, times [s]."""

    method: str
    within: float
    proven: float
    switches: tuple[float, int]
    seconds: tuple[float, float]


def measured(path: Path, number: int) -> tuple[str, list[Row]]:
    """Measures an arm on tips of random configurations, each from the previous goal's configuration."""
    arm = load(path)
    manipulator = arm.manipulator
    map_densities(manipulator, manipulator.length / 20, 1_000)  # loads the kernels
    tracemalloc.start()
    began = time.perf_counter()
    densities = map_densities(manipulator, arm.pixel, arm.level_pixels)
    seconds, most = time.perf_counter() - began, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    head = (
        f"{arm.settings.name}: length {manipulator.length:.3g}, tolerance {arm.tolerance:g}; mapped in {seconds:.2f} s,"
        f" {densities.values.nbytes / 1e6:.1f} MB, pixel {densities.pixels.min():.2g} to {densities.pixels.max():.2g},"
        f" {most / 1e6:.0f} MB on the way"
    )
    solver = Solver(manipulator, densities, arm.weights())
    solver.prepare()
    drawn = np.random.default_rng(1).integers(0, manipulator.states, (number, len(manipulator.states)))
    goals = manipulator.tips(drawn)[:, : manipulator.dimension, 3]
    rows = []
    for method in METHODS:
        home = np.zeros(len(manipulator.states), dtype=np.int64)
        for goal in goals[:WARM]:
            solver.solve(solver.target(goal, arm.tolerance), home, method)
        found = []
        for goal in goals:
            found.append(
                solver.solve(solver.target(goal, arm.tolerance), found[-1].configuration if found else home, method)
            )
        switches, times = [f.switches for f in found], [f.seconds for f in found]
        within, proven = (
            np.mean([f.within_tolerance for f in found]),
            np.mean([f.certificate == "optimal" for f in found]),
        )
        row = (float(np.mean(switches)), max(switches)), (float(np.median(times)), float(np.quantile(times, 0.99)))
        rows.append(Row(method, float(within), float(proven), *row))
    return head, rows


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=200)
    number = parser.parse_args().goals
    console = Console(width=120)
    for path in sorted(DEPLOY.glob("*.yaml")):
        head, rows = measured(path, number)
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
            times = " / ".join(f"{1e3 * t:.2f}" for t in r.seconds)
            table.add_row(r.method, f"{r.within:.1%}", f"{r.proven:.0%}", switches, times)
        console.print(table)


if __name__ == "__main__":
    main()
