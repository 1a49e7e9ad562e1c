"""How time, switches and lower bounds grow with the number of modules: python -m tests.benchmarks.search.growth

With --busy deadlines and times are those of the thread on its processor, so that other programs do not count.
"""

import numpy as np

from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm
from tests.benchmarks.harness import CommandLine, write_figures
from tests.benchmarks.solving import METHODS, Trace, by, compared, home, random_tips, traced

MODULES, LEVEL_PIXELS = (8, 16, 32, 64, 128), 100_000
PIXELS_ALONG = 400  # of the arm's length, as where an arm's configuration names no pixel


def bounds(trace: Trace) -> dict[str, float]:
    """Returns the least bound, and the mean of cost over bound, less one; infinite if a bound is 0."""
    reached = [solution for solution in trace.reached if solution.cost > 0]
    gaps = [solution.cost / solution.bound - 1 if solution.bound > 0 else np.inf for solution in reached]
    return {"least bound": min(solution.bound for solution in reached), "gap": float(np.mean(gaps))}


def main() -> None:
    given, figures = CommandLine(__doc__, goals=100, busy=True, tolerance=0.002).parse(), {}
    for modules in MODULES:
        m = paper_arm(modules)
        solver = Solver(m, map_densities(m, m.length / PIXELS_ALONG, LEVEL_PIXELS))
        solver.prepare()
        goals = random_tips(m, given.goals)
        traces = {method: traced(by(solver, method, given.tolerance), goals, home(m)) for method in METHODS}
        bound = bounds(traces["minimum-switch"])
        title = f"{modules} modules: least bound {bound['least bound']:g}, gap {bound['gap']:.0%}"
        figures[modules] = compared(title, traces) | {"bounds": bound}
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()
