"""The command `bench`: compares methods on goal sets with certified optima."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.bench.methods import METHODS, find_method
from hyperbit.controller.commands import common
from hyperbit.controller.commands.arguments import Dask, Workers
from hyperbit.controller.commands.common import CommandFailed, check_output
from hyperbit.controller.commands.sharing import Sharing, checked_sharing, open_workers, progress_bar, spread_over
from hyperbit.controller.search.method import MINIMUM_SWITCH

if TYPE_CHECKING:
    from distributed import Client
    from rich.table import Table

    from hyperbit.controller.bench.methods import Prepare
    from hyperbit.controller.bench.running import Row

LEGEND = """solved: within the tolerances and clear of obstacles. fewest: with the certified minimum of switches.
proven: claimed to be optimal, not contradicted. switches: mean over solved goals. above: switches above the certified
optimum, mean/most. ms: median/99 %. tables: seconds to prepare. wrong: contradicted certificates."""
BESIDE = "Times were measured while several workers shared the processors; tables: of the slowest worker."

OWN = "Your own method, as module:function or file.py:function; repeatable."


def bench(
    sets: Annotated[
        list[str] | None, typer.Option("--set", help="Name of a goal set; repeatable. Default: all.")
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(help="Names separated by commas. Default: all; with --method: minimum-switch."),
    ] = None,
    method: Annotated[list[str] | None, typer.Option(metavar="MODULE:FUNCTION", help=OWN)] = None,
    count: Annotated[int | None, typer.Option(min=1, help="Most goals of each set.")] = None,
    limit: Annotated[float, typer.Option(min=0.001, help="Longest time for one goal [s].")] = 60.0,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to a file; - is stdout.")] = None,
    names: Annotated[bool, typer.Option("--list", help="Only print the names of sets and methods.")] = False,
    workers: Workers = 1,
    dask: Dask = None,
) -> None:
    """Compare methods of inverse kinematics on goals whose fewest switches are proven.

    The benchmark checks each answer by forward kinematics and counts its switches. Your own method is a function

    \b
        def prepare(arm):
            # arm.states (B,), arm.base (4, 4), arm.frames (B, K, 4, 4), arm.bits (B, K, A), arm.obstacles,
            # arm.bodies, arm.margin; arm.arm is the hyperbit.Arm. See controller/bench/arm.py.
            def solve(goal, start):
                # goal: a hyperbit.Goal: position (2,) or (3,), orientation or None, tolerance, angle_tolerance
                # start: configuration, integers (B,)
                return start
            return solve

    \b
        hyperbit bench --method mine.py:prepare --set paper

    `solve` returns a configuration (B,), None if it finds none, or an object with the attribute `configuration`. If the
    object has a `certificate` ("optimal", "unreachable") or a `bound`, the benchmark checks these as well. A method
    skips an arm or a goal with NotImplementedError. Other exceptions and invalid answers are counted and named. The
    column `tables` has the time of `prepare` and of the first goal of each arm.

    `--workers` and `--dask` share the goals. All but the times stays the same, except for methods that search by time.
    Methods run in this process, or in the workers: run only programs that you trust.
    """  # noqa: D301 - \b keeps click from filling the lines
    from hyperbit.controller.bench.goal_sets import SETS

    if names:
        for title, about in (("sets", SETS), ("methods", {name: entry.summary for name, entry in METHODS.items()})):
            common.console.print(f"{title}:")
            for name, text in about.items():
                common.console.print(f"  {name:24}{text}")
        return
    sharing, chosen, silent = (
        checked_sharing(workers, dask),
        chosen_methods(methods, method or []),
        str(json_file) == "-",
    )
    if unknown := [name for name in sets or [] if name not in SETS]:
        raise InputFaults(Path("--set"), [f"no set {name!r}; there are {', '.join(SETS)}" for name in unknown])
    if json_file is not None and not silent:
        check_output(json_file)
    results = list[SetResult]()

    def remedy() -> str:
        """Returns which sets are done, and how to get the others; "" if none is."""
        done = "" if silent else ", ".join(result.name for result in results)
        return f"the tables of these sets are complete: {done}; choose the others with --set" if done else ""

    with open_workers(sharing, remedy) as client:
        for name in sets or SETS:
            results.append(run_set(name, chosen, limit, count, client))
            if not silent:
                print_result(results[-1])
    if not silent:
        common.console.print(LEGEND)
        if sharing.given:
            common.console.print(BESIDE)
    if json_file is not None:
        write_figures(json_file, results, sharing)
    if impossible := sum(row.impossible for result in results for row in result.rows):
        raise CommandFailed(f"{impossible} answers have fewer switches than the proven minimum: a goal set is wrong")


class SetResult(NamedTuple):
    """The result of a goal set: how many goals it has, of how many the fewest switches are proven, and the rows."""

    name: str
    about: str
    goals: int
    proven: int
    rows: list[Row]


def run_set(name: str, methods: dict[str, Prepare], limit: float, most: int | None, client: Client | None) -> SetResult:
    """Runs methods on a goal set, at most `limit` [s] for a goal, by the workers of a client or by this process."""
    from hyperbit.controller.bench.goal_sets import SETS, read, sample_evenly
    from hyperbit.controller.bench.running import run

    tasks = read(name)
    tasks = sample_evenly(tasks, len(tasks) if most is None else most)
    rows = []
    with progress_bar("goals") as progress, contextlib.redirect_stdout(sys.stderr):  # stdout is for the figures
        for method, prepare in methods.items():
            rows.append(run(method, prepare, tasks, limit, spread_over(client, progress, f"{name}: {method}")))
    return SetResult(name, SETS[name], len(tasks), sum(task.proven for task in tasks), rows)


def print_result(result: SetResult) -> None:
    common.print_table(table(result))
    for row in result.rows:
        for example in row.examples:
            common.console.print(f"  {row.method}: {example}")


def write_figures(file: Path, results: Iterable[SetResult], sharing: Sharing) -> None:
    """Writes the figures of all goal sets as JSON to a file, or to stdout if the file is "-"."""
    figures: dict[str, Any] = {"python": platform.python_version(), "machine": platform.machine()}
    figures |= {"cores": os.cpu_count(), **sharing._asdict(), "sets": {}}
    for result in results:
        figures["sets"][result.name] = {"about": result.about, "goals": result.goals, "certified": result.proven}
        figures["sets"][result.name]["methods"] = [asdict(row) for row in result.rows]
    text = json.dumps(figures, indent=2) + "\n"
    if str(file) == "-":
        sys.stdout.write(text)
    else:
        file.write_text(text, encoding="utf-8")


def chosen_methods(wanted: str | None, own: list[str]) -> dict[str, Prepare]:
    usual = [MINIMUM_SWITCH] if own else list(METHODS)
    listed = usual if wanted is None else [name.strip() for name in wanted.split(",") if name.strip()]
    if unknown := [name for name in listed if name not in METHODS]:
        known = ", ".join(METHODS)
        raise InputFaults(Path("--methods"), [f"no method {name!r}; there are {known}" for name in unknown])
    found = {name: find_method(METHODS[name].target) for name in listed}
    try:
        return found | {target: find_method(target) for target in own}
    except ValueError as error:
        raise InputFaults(Path("--method"), [str(error)]) from None


def table(found: SetResult) -> Table:
    """Returns the table of a goal set: a line for each method that accepts at least one of its goals."""
    headers = ("method", "goals", "solved", "fewest", "proven", "switches", "above", "ms", "tables", "wrong", "errors")
    result = common.results_table(*headers)
    goals = f"{found.goals} goals, the fewest switches of {found.proven} proven"
    result.title, result.title_justify = f"{found.name}: {found.about}: {goals}", "left"
    for column in result.columns[1:]:
        column.justify = "right"
    for r in found.rows:
        if r.goals == 0:
            continue
        cells = [f"{count / r.goals:.1%}" for count in (r.solved, r.fewest, r.proven)]
        cells += ["" if r.switches is None else f"{r.switches:.2f}"]
        cells += ["" if r.above is None else f"{r.above:.2f}/{r.above_most}"]
        times = (r.seconds_median, r.seconds_99)
        cells += ["/".join(f"{1e3 * t:.3g}" for t in times if t is not None), f"{r.tables_seconds:.1f}"]
        result.add_row(r.method, str(r.goals), *cells, str(r.wrong_certificates), str(sum(r.errors.values())))
    if others := [row.method for row in found.rows if row.goals == 0]:
        result.caption, result.caption_justify = f"Not made for these goals: {', '.join(others)}.", "left"
    return result
