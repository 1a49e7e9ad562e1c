"""The command `workspace`: draws and reports where an arm can reach."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import ArmFile, AsJson, Dask, Picture, Tolerance, Workers
from hyperbit.controller.commands.common import (
    console,
    densities_of,
    parse_goal,
    print_json,
    print_table,
    results_table,
    shown,
)
from hyperbit.controller.commands.sharing import checked_sharing, open_workers, progress_bar, spread_over
from hyperbit.controller.commands.study.workspace_report import FIGURES, WorkspaceStudy, describe_study


def workspace(
    file: ArmFile,
    at: Annotated[
        str | None, typer.Option(metavar="X,Y[,Z]", help="Also report the orientations at this point.")
    ] = None,
    locked: Annotated[
        int | None, typer.Option(metavar="K", help="Also report the reach with K actuators locked.")
    ] = None,
    samples: Annotated[int, typer.Option(help="Most random choices of locked actuators, if K is above 1.")] = 100,
    tolerance: Tolerance = None,
    picture: Picture = Path("workspace.png"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of random draws and choices.")] = 0,
    workers: Workers = 1,
    dask: Dask = None,
    as_json: AsJson = False,
) -> None:
    """Draw and report where an arm can reach: positions, orientations at a point, reach with locked actuators.

    `--workers` and `--dask` share the positions, and the choices of locked actuators. The figures stay the same.
    """
    from hyperbit.controller.workspace.coverage import CountJob, coverage_of
    from hyperbit.controller.workspace.locked_reach import LockChoices, reach_when_locked
    from hyperbit.controller.workspace.orientations import orientations_at

    arm = load(file)
    reduced, own = arm.reduced, arm.tolerance if tolerance is None else tolerance
    if not 1e-9 <= own <= 1e6:
        raise InputFaults(Path("--tolerance"), [f"{own:g} is no length from 1e-9 to 1e6"])
    if not 1 <= samples <= 10_000:
        raise InputFaults(Path("--samples"), [f"{samples} is not from 1 to 10000"])
    sharing = checked_sharing(workers, dask)
    point = None if at is None else position(at, arm.manipulator.dimension)
    densities = densities_of(arm, silent=as_json)
    found = None if point is None else orientations_at(reduced, densities, point, own, seed=seed)
    reach = None
    with open_workers(sharing) as client, progress_bar("parts", shown=not as_json) as progress:
        spread = spread_over(client, progress, "positions", lambda part: 1)
        job = None if client is None else CountJob(reduced, arm.pixel, arm.level_pixels, own)
        covered = coverage_of(reduced, densities, own, seed=seed, spread=spread, job=job)
        if locked is not None:
            spread = spread_over(client, progress, "choices of locked actuators")
            try:
                reach = reach_when_locked(reduced, densities, own, LockChoices(locked, samples, seed), spread)
            except ValueError as error:
                raise InputFaults(Path("--locked"), [str(error)]) from None
    study = WorkspaceStudy(arm, densities, covered, own, point, found, locked or 0, reach)
    save_picture(picture, study)
    report = {**describe_study(study), "picture": str(picture)}
    if as_json:
        print_json(report)
    else:
        show(report)


def position(text: str, dimension: int) -> list[float]:
    found, orientation = parse_goal(text, dimension, "--at")
    if orientation is not None:
        raise InputFaults(Path("--at"), [f"{text!r}: a position of {dimension} numbers is needed"])
    return found


def save_picture(file: Path, study: WorkspaceStudy) -> None:
    from hyperbit.controller.pictures.workspace_plots import draw_workspace, locked_field, positions_field

    arm, reach = study.arm, study.locked_reach
    fields = [positions_field(study.densities, arm.manipulator.dimension, study.tolerance)]
    fields += [] if reach is None else [locked_field(reach, study.locks)]
    found = study.orientations if study.orientations is not None and len(study.orientations.counts) else None
    try:
        draw_workspace(arm.reduced, fields, study.point, found, arm.settings.name).savefig(file, dpi=130)
    except (OSError, ValueError) as error:
        raise InputFaults(file, [f"cannot be written: {error}"]) from None


def span(figure: dict[str, float], form: str) -> str:
    """Returns the limits of a figure as text; only one number if the form shows no difference."""
    lower, upper = form.format(figure["lower"]), form.format(figure["upper"])
    return lower if lower == upper else f"{lower}..{upper}"


def show(report: dict[str, Any]) -> None:
    own, tolerance = report["positions"], report["tolerance"]
    kind = "area" if len(own["densest"]) == 2 else "volume"
    console.print(
        f"{report['arm']}: 10^{own['log10_configurations']:.1f} configurations."
        f" {own['positions']} positions, by {own['method']}: {own['why']}.\n"
        f"{kind} with at least one configuration within {tolerance:g}: {span(own['covered'], '{:.3g}')}\n"
        f"configurations within {tolerance:g}: median {span(own['log10_redundancy'], '10^{:.1f}')} over that {kind},"
        f" 10^{own['log10_greatest_redundancy']:.1f} near {shown(own['densest'])}. Obstacles are not considered."
    )
    if (at := report.get("at")) is not None:
        console.print(
            f"at {shown(at['position'])}, by {at['method']}: {at['why']}.\n"
            f"{at['configurations']:.4g} configurations within {tolerance:g},"
            f" standard error {at['standard_error']:.2g}"
        )
        if at["mean"] is not None:
            console.print(f"mean orientation {shown(at['mean'])}, spread {at['spread']:.3f} rad")
    if (locked := report.get("locked")) is not None:
        number = len(locked["choices"])
        every = f"all {number} choices" if locked["every"] else f"{number} random choices"
        console.print(f"{locked['actuators']} locked, {every}, by {locked['method']}: {locked['why']}.")
        table = results_table("", "free", "mean", "worst", "locked")
        for name in FIGURES:
            worst = locked["worst"][name]
            values = (locked["free"][name], locked["mean"][name], worst[name])
            states = ", ".join(f"{label}={state}" for label, state in worst["locked"].items())
            table.add_row(name, *("none" if value is None else f"{value:.4g}" for value in values), states)
        print_table(table)
        console.print(
            "reach: of pixels with a tip; covered: expected with a configuration within the tolerance;"
            " log10_redundancy: of expected configurations within the tolerance, median over the free arm's coverage"
        )
    console.print(f"picture: {report['picture']}")
