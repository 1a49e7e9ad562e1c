"""How time, switches and lower bounds grow with the number of modules: python -m tests.benchmarks.search.growth

With --busy deadlines and times are those of the thread on its processor, so that other programs do not count.
"""

from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console
from rich.table import Table

from hyperbit.controller.search.method import METHODS as PRODUCT_METHODS
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm
from tests.benchmarks.harness import CommandLine, write_figures
from tests.benchmarks.search.goals import random
from tests.benchmarks.search.measuring import Arm, Goals, prepared, traced
from tests.benchmarks.search.methods import METHODS, product

MODULES, LEVEL_PIXELS = (8, 16, 32, 64, 128), 100_000
PIXELS_ALONG = 400  # of the arm's length, as where an arm's configuration names no pixel
NAMES = [f"hyperbit {name}" for name in ("minimum-switch", "ipop-fewest-switches", "pop") if name in PRODUCT_METHODS]


@dataclass(frozen=True)
class Grown:
    """One number of modules: median and 99 % time [s], mean switches and share within the tolerance, by method.

    Attributes:
        proven: share of the goals whose minimum-switch answer is proven optimal.
        least_bound: least lower bound of a goal.
        gap: mean of (cost - bound) / bound, over the goals that are reached; infinite if a bound is 0.
    """

    modules: int
    seconds: dict[str, float]
    seconds_99: dict[str, float]
    switches: dict[str, float]
    within: dict[str, float]
    proven: float = 0.0
    least_bound: float = 0.0
    gap: float = 0.0


def growth(number: int, tolerance: float) -> list[Grown]:
    return [grown(modules, number, tolerance) for modules in MODULES]


def grown(modules: int, number: int, tolerance: float) -> Grown:
    manipulator = paper_arm(modules)
    densities = map_densities(manipulator, manipulator.length / PIXELS_ALONG, LEVEL_PIXELS)
    arm = Arm(manipulator, densities, 0.0, tolerance)
    goals = random(manipulator, densities, tolerance, number)
    result = Grown(modules, {}, {}, {}, {})
    for method in METHODS:
        if method.name in NAMES:
            problem, *_ = prepared(method, arm)
            trace = traced(method, problem, arm, goals)
            result.seconds[method.name] = float(np.median(trace.seconds))
            result.seconds_99[method.name] = float(np.quantile(trace.seconds, 0.99))
            result.switches[method.name] = float(trace.switches.mean())
            result.within[method.name] = float(np.mean(trace.errors <= tolerance))
        if method.name == NAMES[0]:
            result = bounded(result, problem, arm, goals)
    return result


def bounded(result: Grown, problem: product.Problem, arm: Arm, goals: Goals) -> Grown:
    """Adds the figures of the lower bounds; each goal starts from the previous goal's configuration."""
    own, found = arm.home, []
    for goal in goals:
        found.append(product.solution(problem, goal, own, arm.tolerance))
        own = found[-1].configuration
    reached = [f for f in found if f.within_tolerance and f.cost > 0]
    gaps = [f.cost / f.bound - 1 if f.bound > 0 else np.inf for f in reached]
    proven, least = np.mean([f.certificate == "optimal" for f in found]), min(f.bound for f in reached)
    return replace(result, proven=float(proven), least_bound=float(least), gap=float(np.mean(gaps)))


def growth_table(rows: list[Grown]) -> Table:
    table = Table("modules", title="growth with the number of modules: random goals, from contracted")
    for name in NAMES:
        short = name.removeprefix("hyperbit ")
        for header in (f"{short}\nms", "99 %\nms", "switches", "within"):
            table.add_column(header, justify="right")
    for header in ("proven", "least\nbound", "mean\ngap"):
        table.add_column(header, justify="right")
    for r in rows:
        cells = []
        for name in NAMES:
            cells += [f"{1e3 * r.seconds[name]:.3f}", f"{1e3 * r.seconds_99[name]:.3f}"]
            cells += [f"{r.switches[name]:.2f}", f"{r.within[name]:.1%}"]
        table.add_row(str(r.modules), *cells, f"{r.proven:.0%}", f"{r.least_bound:g}", f"{r.gap:.0%}")
    return table


def main() -> None:
    parser = CommandLine(__doc__, goals=100, busy=True)
    parser.add_argument("--tolerance", type=float, default=0.002)
    given = parser.parse()
    rows = growth(given.goals, given.tolerance)
    Console(width=170).print(growth_table(rows))
    write_figures(given.json, rows)


if __name__ == "__main__":
    main()
