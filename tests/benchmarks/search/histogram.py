"""Distribution of the minimum of switches over goals of the paper's arm: python -m tests.benchmarks.search.histogram

Goals are tips of random configurations. Each search starts at the optimal configuration of the previous goal, and gets
enough time to prove nearly all optima.
"""

import numpy as np
from rich.console import Console
from rich.table import Table

from hyperbit.controller.arm.arm import load
from tests.benchmarks.harness import PAPER_ARM, CommandLine, write_figures
from tests.benchmarks.solving import home, random_tips, ready_solver

SECONDS = 5.0  # for a proof


def main() -> None:
    given = CommandLine(__doc__, goals=10_000).parse()
    arm = load(PAPER_ARM)
    m, solver = arm.manipulator, ready_solver(arm)
    tips, previous = random_tips(m, given.goals)[:, :2, 3], home(m)
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
    write_figures(given.json, rows)


if __name__ == "__main__":
    main()
