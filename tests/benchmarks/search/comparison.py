"""Every method side by side on the same goals: python -m tests.benchmarks.search.comparison [--goals N] [--set NAME]

The arm is the paper's, of 16 modules. Each method goes through a set in sequence, from the configuration that it
reached for the goal before. The ratio to the proven optimum is measured apart, over the first goals of the set, all
methods from the same configurations: those of fewest switches for the goal before.
"""

import os
import platform
import sys
from typing import Any

import numpy as np
from rich.console import Console

from hyperbit.controller.search.method import METHODS as PRODUCT_METHODS
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm
from tests.benchmarks.harness import CommandLine, show, timed, write_figures
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


Row = dict[str, Any]  # by method's figure; times in seconds, memory in bytes, errors as positions
COLUMNS = {  # of the table: the figure, its form and its factor
    "goals": ("goals", "", 1),
    "within": ("within", ".1%", 1),
    "switches": ("switches_mean", ".2f", 1),
    "worst": ("switches_worst", "", 1),
    "ratio to\noptimum": ("ratio", ".3f", 1),
    "over\ngoals": ("ratio_goals", "", 1),
    "error\nmm": ("error_median", ".2f", 1e3),
    "99 %\nmm": ("error_99", ".2f", 1e3),
    "time\nms": ("seconds_median", ".3f", 1e3),
    "99 %\nms": ("seconds_99", ".3f", 1e3),
    "tables\ns": ("tables_seconds", ".2f", 1),
    "tables\nMiB": ("tables_bytes", ".1f", 2**-20),
}


def row(name: str, trace: Trace, arm: Arm, ratio: tuple[float | None, int], tables: tuple[float, int]) -> Row:
    return {
        "method": name,
        "goals": len(trace.switches),
        "within": float(np.mean(trace.errors <= arm.tolerance)),
        "switches_mean": float(trace.switches.mean()),
        "switches_worst": int(trace.switches.max()),
        **dict(zip(("ratio", "ratio_goals"), ratio, strict=True)),
        **{f"error_{part}": float(np.quantile(trace.errors, q)) for part, q in (("median", 0.5), ("99", 0.99))},
        **{f"seconds_{part}": float(np.quantile(trace.seconds, q)) for part, q in (("median", 0.5), ("99", 0.99))},
        **dict(zip(("tables_seconds", "tables_bytes"), tables, strict=True)),
    }


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


def show_set(name: str, rows: list[Row], proofs: dict[str, int]) -> None:
    caption = f"Optimum proven for {proofs['proven']} of the first {proofs['tried']} goals: its row is of those alone. "
    caption += "The ratio is over those that a method brings within the tolerance."
    if "claimed" in proofs:
        caption += f" {OURS} itself claims to have proven {proofs['claimed']} of them optimal; "
        caption += f"{proofs['confirmed']} confirmed, {proofs['contradicted']} contradicted."
    cells = [
        [
            r["method"],
            *("-" if r[key] is None else format(r[key] * times, form) for key, form, times in COLUMNS.values()),
        ]
        for r in rows
    ]
    show(f"{name}: tolerance {TOLERANCE * 1e3:g} mm. {caption}", ("method", *COLUMNS), cells, 150)


def main() -> None:
    parser = CommandLine(__doc__, goals=1_000)
    parser.add_argument("--set", choices=SETS, help="this set alone, without the growth with the number of modules")
    arguments = parser.parse()
    progress = Console(stderr=True)
    if OURS not in PRODUCT_METHODS:
        print(f"The product has no method {OURS} yet: left out.")
    manipulator = paper_arm(MODULES)
    map_densities(paper_arm(2), 0.1, 100)  # loads the kernels
    densities, mapping = timed(lambda: map_densities(manipulator, PIXEL, LEVEL_PIXELS))
    arm = Arm(manipulator, densities, mapping, TOLERANCE)
    figures = {"modules": MODULES, "pixel": PIXEL, "tolerance": TOLERANCE, "sets": {}}
    figures |= {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}
    for name in [arguments.set] if arguments.set else SETS:
        rows, proofs = compared(name, arm, arguments.goals, progress)
        show_set(name, rows, proofs)
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
