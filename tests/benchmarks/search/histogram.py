"""Distribution of the minimum of switches over goals of the paper's arm: python -m tests.benchmarks.search.histogram

Goals are tips of random configurations. Each search starts at the optimal configuration of the previous goal, and gets
enough time to prove nearly all optima.
"""

from hyperbit.controller.arm.arm import load
from tests.benchmarks.harness import PAPER_ARM, CommandLine, joined, show, write_figures
from tests.benchmarks.solving import by, home, random_tips, ready_solver, traced

SECONDS = 5.0  # for a proof


def main() -> None:
    given, arm = CommandLine(__doc__, goals=10_000).parse(), load(PAPER_ARM)
    solve = by(ready_solver(arm), "minimum-switch", arm.tolerance, timeout=SECONDS)
    trace = traced(solve, random_tips(arm.manipulator, given.goals), home(arm.manipulator))
    rows = []
    for number in sorted({solution.switches for solution in trace.found}):
        own = [solution for solution in trace.found if solution.switches == number]
        proven = sum(solution.certificate == "optimal" for solution in own)
        rows.append((number, len(own), proven, joined([solution.seconds for solution in own], "p50", "worst")))
    show(f"{given.goals} goals", ("switches", "goals", "of them proven", "time, median / most [ms]"), rows)
    write_figures(given.json, rows)


if __name__ == "__main__":
    main()
