"""Distribution of the minimum of switches over goals of the paper's arm: python -m tests.benchmarks.histogram

Goals are tips of random configurations. Each search starts at the optimal configuration of the previous goal, and gets
enough time to prove nearly all optima.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from controller.arm.arm import load
from controller.search.solver import Solver
from controller.workspace.mapping import map_densities
from tests.benchmarks.arms import DEPLOY

SECONDS = 5.0  # for a proof


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=10_000)
    parser.add_argument("--json", type=Path, help="write the counts, too")
    given = parser.parse_args()
    arm = load(DEPLOY / "planar16.yaml")
    m = arm.manipulator
    solver = Solver(m, map_densities(m, arm.pixel, arm.level_pixels))
    solver.prepare()
    tips = m.tips(np.random.default_rng(1).integers(0, m.states, (given.goals, len(m.states))))[:, :2, 3]
    previous = np.zeros(len(m.states), dtype=np.int64)
    switches, proven, seconds = (np.zeros(given.goals) for _ in range(3))
    for k, goal in enumerate(tips):
        found = solver.solve(solver.target(goal, arm.tolerance), previous, timeout=SECONDS)
        switches[k], proven[k], seconds[k] = found.switches, found.certificate == "optimal", found.seconds
        previous = found.configuration
    table = Table("switches", "goals", "of them proven", "time, median / most [ms]", title=f"{given.goals} goals")
    rows = []
    for number in range(int(switches.max()) + 1):
        here = switches == number
        if here.any():
            median, most = 1e3 * np.median(seconds[here]), 1e3 * seconds[here].max()
            table.add_row(str(number), str(here.sum()), str(int(proven[here].sum())), f"{median:.1f} / {most:.1f}")
            rows.append({"switches": number, "goals": int(here.sum()), "proven": int(proven[here].sum())})
    Console(width=120).print(table)
    if given.json is not None:
        given.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
