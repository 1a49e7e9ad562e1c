"""Every method side by side on the same goals: python -m tests.benchmarks.search.comparison [--goals N] [--set NAME]

The arm is the paper's, of 16 modules. Each method goes through a set in sequence, from the configuration that it
reached for the goal before. The ratio to the proven optimum is measured apart, over the first goals of the set, all
methods from the same configurations: those of fewest switches for the goal before.
"""

import os
import platform
import sys
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from hyperbit.controller.search.method import METHODS as PRODUCT_METHODS
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm
from tests.benchmarks.harness import CommandLine, timed, write_figures
from tests.benchmarks.search.goals import SETS
from tests.benchmarks.search.growth import growth
from tests.benchmarks.search.measuring import (
    Arm,
    Goals,
    Proofs,
    Trace,
    claimed,
    memory,
    prepared,
    proven,
    ratio,
    traced,
)
from tests.benchmarks.search.methods import METHODS, OPTIMUM, OURS, Method

MODULES, PIXEL, LEVEL_PIXELS = 16, 0.01, 1_000_000
TOLERANCE = 0.002
PROOFS = 100
PROOF_SECONDS, PROOF_SHARE = 25.0, 0.08  # for all proofs of one set: at most, and for each goal asked for


@dataclass(frozen=True)
class Row:
    """Measurements of one method on one set; times in seconds, memory in bytes."""

    method: str
    goals: int
    within: float
    switches_mean: float
    switches_worst: int
    ratio: float | None
    ratio_goals: int
    error_median: float
    error_99: float
    seconds_median: float
    seconds_99: float
    tables_seconds: float
    tables_bytes: int


def row(name: str, trace: Trace, arm: Arm, ratio: tuple[float | None, int], tables: tuple[float, int]) -> Row:
    return Row(
        name,
        len(trace.switches),
        float(np.mean(trace.errors <= arm.tolerance)),
        float(trace.switches.mean()),
        int(trace.switches.max()),
        *ratio,
        *(float(np.quantile(trace.errors, q)) for q in (0.5, 0.99)),
        *(float(np.quantile(trace.seconds, q)) for q in (0.5, 0.99)),
        *tables,
    )


def measured(method: Method, arm: Arm, goals: Goals, proofs: Proofs) -> Row:
    problem, *tables = prepared(method, arm)
    trace = traced(method, problem, arm, goals)
    return row(method.name, trace, arm, ratio(method, problem, arm, goals, proofs), tuple(tables))


def compared(name: str, arm: Arm, number: int, console: Console) -> tuple[list[Row], dict[str, int]]:
    draw, most = SETS[name]
    goals = draw(arm.manipulator, arm.densities, arm.tolerance, min(number, most))
    problem, seconds, _ = prepared(OPTIMUM, arm)
    with console.status(f"{name}: {OPTIMUM.name}"):
        proofs = proven(problem, arm, goals[:PROOFS], min(PROOF_SECONDS, PROOF_SHARE * number))
    rows = []
    for method in METHODS:
        with console.status(f"{name}: {method.name}"):
            rows.append(measured(method, arm, goals, proofs))
    known = proofs.fewest >= 0
    if known.any():
        trace = Trace(proofs.fewest[known], proofs.trace.errors[known], proofs.trace.seconds[known])
        name = f"{OPTIMUM.name}, {known.sum()} of {len(known)}"
        rows.append(row(name, trace, arm, (1.0, len(trace.switches)), (seconds, memory(problem))))
    figures = {"tried": len(known), "proven": int(known.sum())}
    if OURS in PRODUCT_METHODS:
        claims = claimed(prepared(METHODS[0], arm)[0], arm, goals, proofs)
        figures |= dict(zip(("claimed", "confirmed", "contradicted"), map(int, claims), strict=True))
    return rows, figures


def table(name: str, rows: list[Row], proofs: dict[str, int]) -> Table:
    headers = ("goals", "within", "switches", "worst", "ratio to\noptimum", "over\ngoals", "error\nmm", "99 %\nmm")
    headers += ("time\nms", "99 %\nms", "tables\ns", "tables\nMiB")
    caption = f"Optimum proven for {proofs['proven']} of the first {proofs['tried']} goals: its row is of those alone. "
    caption += "The ratio is over those that a method brings within the tolerance."
    if "claimed" in proofs:
        caption += f" {OURS} itself claims to have proven {proofs['claimed']} of them optimal; "
        caption += f"{proofs['confirmed']} confirmed, {proofs['contradicted']} contradicted."
    result = Table("method", title=f"{name}: tolerance {TOLERANCE * 1e3:g} mm", caption=caption)
    for header in headers:
        result.add_column(header, justify="right")
    for r in rows:
        figures = [f"{r.goals}", f"{r.within:.1%}", f"{r.switches_mean:.2f}", f"{r.switches_worst}"]
        figures += ["-" if r.ratio is None else f"{r.ratio:.3f}", f"{r.ratio_goals}"]
        figures += [f"{1e3 * r.error_median:.2f}", f"{1e3 * r.error_99:.2f}"]
        figures += [f"{1e3 * r.seconds_median:.3f}", f"{1e3 * r.seconds_99:.3f}"]
        figures += [f"{r.tables_seconds:.2f}", f"{r.tables_bytes / 2**20:.1f}"]
        result.add_row(r.method, *figures)
    return result


def main() -> None:
    parser = CommandLine(__doc__, goals=1_000)
    parser.add_argument("--set", choices=SETS, help="this set alone, without the growth with the number of modules")
    arguments = parser.parse()
    console, progress = Console(width=max(150, Console().width)), Console(stderr=True)
    if OURS not in PRODUCT_METHODS:
        console.print(f"The product has no method {OURS} yet: left out.")
    manipulator = paper_arm(MODULES)
    map_densities(paper_arm(2), 0.1, 100)  # loads the kernels
    densities, mapping = timed(lambda: map_densities(manipulator, PIXEL, LEVEL_PIXELS))
    arm = Arm(manipulator, densities, mapping, TOLERANCE)
    figures = {"modules": MODULES, "pixel": PIXEL, "tolerance": TOLERANCE, "sets": {}}
    figures |= {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}
    for name in [arguments.set] if arguments.set else SETS:
        rows, proofs = compared(name, arm, arguments.goals, progress)
        console.print(table(name, rows, proofs))
        figures["sets"][name] = {"proofs": proofs, "rows": rows}
    if not arguments.set:
        figures["growth"] = growth(min(arguments.goals, 100), TOLERANCE)
    write_figures(arguments.json, figures)


if __name__ == "__main__":
    # One thread for every method, as the compiled kernels have one too: libraries read this when they are loaded.
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        os.execve(
            sys.executable, [sys.executable, "-m", "tests.benchmarks.search.comparison", *sys.argv[1:]], environment
        )
    main()
