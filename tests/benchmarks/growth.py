"""How time and switches of the product's methods grow with the number of modules."""

from dataclasses import dataclass

import numpy as np
from rich.table import Table

from controller.search.method import METHODS as PRODUCT_METHODS
from controller.workspace.mapping import map_densities
from tests.arms import paper_arm
from tests.benchmarks.goals import random
from tests.benchmarks.measuring import Arm, prepared, traced
from tests.benchmarks.methods import METHODS

MODULES, LEVEL_PIXELS = (8, 16, 32, 64, 128), 100_000
PIXELS_ALONG = 400  # of the arm's length, as where an arm's configuration names no pixel
NAMES = [f"hyperbit {name}" for name in ("minimum-switch", "ipop-fewest-switches", "pop") if name in PRODUCT_METHODS]


@dataclass(frozen=True)
class Grown:
    """One number of modules: median and 99 % time [s], mean switches and share within the tolerance, by method."""

    modules: int
    seconds: dict[str, float]
    seconds_99: dict[str, float]
    switches: dict[str, float]
    within: dict[str, float]


def growth(number: int, tolerance: float) -> list[Grown]:
    """Measures the arms of MODULES modules on so many random goals each."""
    return [grown(modules, number, tolerance) for modules in MODULES]


def grown(modules: int, number: int, tolerance: float) -> Grown:
    """Measures one arm."""
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
    return result


def growth_table(rows: list[Grown]) -> Table:
    """Returns the table."""
    table = Table("modules", title="growth with the number of modules: random goals, from contracted")
    for name in NAMES:
        short = name.removeprefix("hyperbit ")
        for header in (f"{short}\nms", "99 %\nms", "switches", "within"):
            table.add_column(header, justify="right")
    for r in rows:
        cells = []
        for name in NAMES:
            cells += [f"{1e3 * r.seconds[name]:.3f}", f"{1e3 * r.seconds_99[name]:.3f}"]
            cells += [f"{r.switches[name]:.2f}", f"{r.within[name]:.1%}"]
        table.add_row(str(r.modules), *cells)
    return table
