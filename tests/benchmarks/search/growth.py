"""How time, switches and lower bounds grow with the number of modules: python -m tests.benchmarks.search.growth

With --busy deadlines and times are those of the thread on its processor, so that other programs do not count.
"""

import numpy as np

from hyperbit.controller.search.method import METHODS as PRODUCT_METHODS
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm
from tests.benchmarks.harness import CommandLine, show, write_figures
from tests.benchmarks.search.goals import random
from tests.benchmarks.search.measuring import Arm, Goals, prepared, traced
from tests.benchmarks.search.methods import METHODS, product

MODULES, LEVEL_PIXELS = (8, 16, 32, 64, 128), 100_000
PIXELS_ALONG = 400  # of the arm's length, as where an arm's configuration names no pixel
NAMES = [f"hyperbit {name}" for name in ("minimum-switch", "ipop-fewest-switches", "pop") if name in PRODUCT_METHODS]
Figures = dict[str, float]


def growth(number: int, tolerance: float) -> dict[int, Figures]:
    figures = {modules: grown(modules, number, tolerance) for modules in MODULES}
    headers = [name.removeprefix("hyperbit ").replace(", ", "\n") for name in figures[MODULES[0]]]
    rows = [(modules, *(f"{value:.3g}" for value in row.values())) for modules, row in figures.items()]
    title = "growth with the number of modules: random goals, from contracted"
    show(title, ("modules", *headers), rows, 170)
    return figures


def grown(modules: int, number: int, tolerance: float) -> Figures:
    """Returns times [ms], mean switches and share within the tolerance of each method, and figures of the bounds."""
    manipulator = paper_arm(modules)
    densities = map_densities(manipulator, manipulator.length / PIXELS_ALONG, LEVEL_PIXELS)
    arm = Arm(manipulator, densities, 0.0, tolerance)
    goals = random(manipulator, densities, tolerance, number)
    found: Figures = {}
    for method in METHODS:
        if method.name in NAMES:
            problem, *_ = prepared(method, arm)
            trace = traced(method, problem, arm, goals)
            found[f"{method.name}, ms"] = 1e3 * float(np.median(trace.seconds))
            found[f"{method.name}, 99 % ms"] = 1e3 * float(np.quantile(trace.seconds, 0.99))
            found[f"{method.name}, switches"] = float(trace.switches.mean())
            found[f"{method.name}, within"] = float(np.mean(trace.errors <= tolerance))
        if method.name == NAMES[0]:
            bounds = bounded(problem, arm, goals)
    return found | bounds


def bounded(problem: product.Problem, arm: Arm, goals: Goals) -> Figures:
    """Returns share of proven answers, least bound, and mean of (cost - bound) / bound; infinite if a bound is 0.

    Each goal starts from the previous goal's configuration.
    """
    own, found = arm.home, []
    for goal in goals:
        found.append(product.solution(problem, goal, own, arm.tolerance))
        own = found[-1].configuration
    reached = [f for f in found if f.within_tolerance and f.cost > 0]
    gaps = [f.cost / f.bound - 1 if f.bound > 0 else np.inf for f in reached]
    proven, least = np.mean([f.certificate == "optimal" for f in found]), min(f.bound for f in reached)
    return {"proven": float(proven), "least bound": float(least), "gap": float(np.mean(gaps))}


if __name__ == "__main__":
    parser = CommandLine(__doc__, goals=100, busy=True)
    parser.add_argument("--tolerance", type=float, default=0.002)
    given = parser.parse()
    write_figures(given.json, growth(given.goals, given.tolerance))
