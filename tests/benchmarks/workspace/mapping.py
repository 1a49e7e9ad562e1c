"""Growth of mapping and search with the number of modules: python -m tests.benchmarks.workspace.mapping [--json PATH].

Every arm is the paper's, longer or shorter. Pixels are so fine that the bound on a level's pixels binds from the first
modules on: then each level costs the same, and time and memory must grow with the number of modules, B. The last five
modules have fewer points than pixels and cost less, so the fitted exponent of the time lies a little above 1.
"""

import json
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.method import METHODS
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm
from tests.benchmarks.harness import CommandLine, timed, write_figures
from tests.benchmarks.search.measuring import exponent
from tests.benchmarks.solving import home, random_tips

MODULES = (8, 16, 32, 64, 128, 256)
PIXEL, LEVEL_PIXELS = 0.001, 100_000
REPEATS, GOALS, TOLERANCE = 3, 100, 0.002


@dataclass(frozen=True)
class Row:
    """Measurements of one arm; times in processor seconds, memory in MiB.

    Attributes:
        mapping: least time to map all densities.
        peak: most memory of the process while it mapped, less that before.
    """

    modules: int
    mapping: float
    densities: float
    peak: float
    goal: dict[str, float]
    error: dict[str, float]
    switches: dict[str, float]


def mapped(manipulator: Manipulator) -> tuple[Densities, float]:
    """Maps an arm; returns its densities and the processor time [s]."""
    return timed(lambda: map_densities(manipulator, PIXEL, LEVEL_PIXELS), time.process_time)


def measured(modules: int) -> Row:
    manipulator = paper_arm(modules)
    map_densities(paper_arm(2), 0.1, 100)  # loads the kernels
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    densities, mapping = mapped(manipulator)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    mapping = min([mapping, *(mapped(manipulator)[1] for _ in range(REPEATS - 1))])
    solver = Solver(manipulator, densities)
    goals = random_tips(manipulator, GOALS, seed=0)[:, :2, 3]
    goal, error, switches = {}, {}, {}
    for method in METHODS:
        previous, found, began = home(manipulator), [], time.process_time()
        for position in goals:
            found.append(solver.solve(solver.target(position, TOLERANCE), previous, method))
            previous = found[-1].configuration
        goal[method] = (time.process_time() - began) / GOALS
        error[method] = float(np.median([s.error for s in found]))
        switches[method] = float(np.mean([s.switches for s in found]))
    memory = sum(array.nbytes for array in vars(densities).values())
    return Row(modules, mapping, memory / 2**20, peak / 2**10, goal, error, switches)


def main() -> None:
    parser = CommandLine(__doc__)
    parser.add_argument("--only", type=int, help="measure one number of modules here, and print JSON")
    arguments = parser.parse()
    if arguments.only is not None:
        print(json.dumps(asdict(measured(arguments.only))))
        return
    own = [sys.executable, "-m", "tests.benchmarks.workspace.mapping", "--only"]
    run = {"check": True, "capture_output": True, "text": True}
    rows = [
        Row(**json.loads(subprocess.run([*own, str(modules)], **run).stdout))
        for modules in track(MODULES, "measuring", console=Console(stderr=True), transient=True)
    ]
    columns = {
        "mapping s": ([row.mapping for row in rows], "{:.2f}"),
        "densities MiB": ([row.densities for row in rows], "{:.1f}"),
        "peak MiB": ([row.peak for row in rows], "{:.0f}"),
        **{f"{method} ms": ([1e3 * row.goal[method] for row in rows], "{:.3f}") for method in METHODS},
    }
    exponents = {name: exponent(list(MODULES), values) for name, (values, _) in columns.items()}
    headers = [name.replace("-", " ").replace(" ", "\n") for name in columns]
    table = Table("B", *headers, title=f"{LEVEL_PIXELS:,} pixels a level at most, {GOALS} goals", show_footer=True)
    table.columns[0].footer = "exponent"
    for column, fitted in zip(table.columns[1:], exponents.values(), strict=True):
        column.footer, column.justify = f"{fitted:.2f}", "right"
    for k, modules in enumerate(MODULES):
        table.add_row(str(modules), *[shown.format(values[k]) for values, shown in columns.values()])
    Console().print(table)
    figures = {"pixel": PIXEL, "level_pixels": LEVEL_PIXELS, "goals": GOALS, "tolerance": TOLERANCE}
    write_figures(arguments.json, figures | {"rows": rows, "exponents": exponents})


if __name__ == "__main__":
    main()
