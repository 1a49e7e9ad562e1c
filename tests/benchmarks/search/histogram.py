"""Distribution of the minimum of switches over goals of the paper's arm: python -m tests.benchmarks.search.histogram

Goals are tips of random configurations. Each search starts at the optimal configuration of the previous goal, and gets
enough time to prove nearly all optima.
"""

import numpy as np

from hyperbit.controller.arm.arm import load
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, write_figures
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
    rows = []
    for number in range(int(switches.max()) + 1):
        here = switches == number
        if here.any():
            times = f"{1e3 * np.median(seconds[here]):.1f} / {1e3 * seconds[here].max():.1f}"
            rows.append((number, int(here.sum()), int(proven[here].sum()), times))
    show(f"{given.goals} goals", ("switches", "goals", "of them proven", "time, median / most [ms]"), rows)
    write_figures(given.json, rows)


if __name__ == "__main__":
    main()
