"""The command `workspace`: draws and reports where an arm can reach."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.armfile.goal_files import parse_goal
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.units import unit_mark
from hyperbit.controller.commands.arguments import ArmFile, AsJson, Dask, Picture, Tolerance, Workers
from hyperbit.controller.commands.common import (
    check_picture,
    console,
    densities_of,
    drawing,
    print_json,
    print_table,
    results_table,
    shown,
)
from hyperbit.controller.commands.sharing import checked_sharing, open_workers, progress_bar, spread_over
from hyperbit.controller.manipulator.frames import quaternion

if TYPE_CHECKING:
    from hyperbit.controller.search.obstructed import Obstructed
    from hyperbit.controller.search.solver import Solver
    from hyperbit.controller.workspace.coverage import Coverage, Range
    from hyperbit.controller.workspace.densities import Densities
    from hyperbit.controller.workspace.locked_reach import LockedReach, Reach
    from hyperbit.controller.workspace.orientations import Orientations

FIGURES = ("reach", "covered", "log10_redundancy")
DRAWN = "random draws, weighted by the Mapping Algorithm's densities; a grid over orientations would be far too coarse"
COUNTED = {
    "listing": "the arm has few configurations, all are listed",
    "halves": "configurations are counted exactly, as pairs of two lists",
    "draws": "random draws, weighted by the Mapping Algorithm's densities; the arm has too many configurations to list",
}
OBSTACLES = "Also report how much of the area the arm's obstacles take away, and which of them."
LOCKED = "a lock changes only the intermediate workspaces below its module; the others are mapped once"


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
    obstacles: Annotated[bool, typer.Option("--obstacles", help=OBSTACLES)] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of random draws and choices.")] = 0,
    workers: Workers = 1,
    dask: Dask = None,
    as_json: AsJson = False,
) -> None:
    """Draw and report where an arm can reach: positions, orientations at a point, reach with locked actuators.

    `--workers` and `--dask` share the positions, and the choices of locked actuators. The figures stay the same.
    """
    from hyperbit.controller.search.obstructed import obstructed
    from hyperbit.controller.workspace.coverage import CountJob, coverage_of
    from hyperbit.controller.workspace.locked_reach import LockChoices, reach_when_locked
    from hyperbit.controller.workspace.orientations import orientations_at

    check_picture(picture)
    arm = load(file)
    reduced, own = arm.reduced, arm.tolerance if tolerance is None else tolerance
    if not 1e-9 <= own <= 1e6:
        raise InputFaults(Path("--tolerance"), [f"{own:g} is no length from 1e-9 to 1e6"])
    if not 1 <= samples <= 10_000:
        raise InputFaults(Path("--samples"), [f"{samples} is not from 1 to 10000"])
    if obstacles and arm.clearance().free:
        raise InputFaults(Path("--obstacles"), [f"{file} has neither `obstacles` nor `self_collision`"])
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
    lost = None if not obstacles else obstructed(solver_of(arm, densities), own, seed=seed)
    from hyperbit.controller.pictures.workspace_plots import draw_workspace, locked_field, positions_field

    unit = arm.settings.unit
    fields: dict[str, Any] = {"arm": arm.settings.name, "unit": unit, "tolerance": own, "positions": positions(covered)}
    drawn = [positions_field(densities, arm.manipulator.dimension, own)]
    if found is not None:
        fields["at"] = {"position": point, **orientations(found, planar=arm.manipulator.planar)}
    if reach is not None:
        fields["locked"] = locks(arm, reach, locked or 0)
        drawn.append(locked_field(reach, locked or 0))
    if lost is not None:
        fields["obstacles"] = losses(lost)
    shown_at = found if found is not None and len(found.counts) else None
    among = None if lost is None else (arm.obstacles, lost.positions[~lost.reached])
    with drawing(picture):
        draw_workspace(reduced, drawn, point, shown_at, arm.settings.name, unit, among).savefig(picture, dpi=130)
    fields["picture"] = str(picture)
    if as_json:
        print_json(fields)
    else:
        show(fields)


def position(text: str, dimension: int) -> list[float]:
    found, orientation = parse_goal(text.split(","), dimension, "--at")
    if orientation is not None:
        raise InputFaults(Path("--at"), [f"{text!r}: a position of {dimension} numbers is needed"])
    return found


def positions(found: Coverage) -> dict[str, Any]:
    """Returns the figures of positions. Names of logarithms begin with `log10_`."""
    return {
        "method": found.method,
        "why": COUNTED[found.method],
        "positions": found.positions,
        "log10_configurations": found.log10_configurations,
        "covered": limits(found.area),
        "log10_redundancy": limits(found.log10_median),
        "log10_greatest_redundancy": found.log10_greatest,
        "densest": found.densest.tolist(),
    }


def limits(figure: Range) -> dict[str, float]:
    return {"lower": figure.lower, "estimate": figure.middle, "upper": figure.upper}


def orientations(found: Orientations, *, planar: bool) -> dict[str, Any]:
    from hyperbit.controller.pictures.orientation_plots import angles_of, arcs, directions, twists

    exact = found.draws == 0
    fields: dict[str, Any] = {
        "method": "enumeration" if exact else "mapping",
        "why": "the arm has few configurations, all are enumerated" if exact else DRAWN,
        "configurations": found.total,
        "standard_error": found.deviation,
        "draws": found.draws,
        "mean": None,
        "spread": None,
    }
    if len(found.counts) == 0:
        return fields
    frame = np.eye(4)
    frame[:3, :3] = found.mean
    fields["mean"] = float(angles_of(frame[None, :3, :3])[0]) if planar else quaternion(frame).tolist()
    fields["spread"] = found.spread
    if planar:
        return fields | {"angles": arcs(angles_of(found.rotations), found.counts).tolist()}
    return fields | {
        "directions": directions(found).tolist(),
        "twists": arcs(twists(found.rotations), found.counts).tolist(),
    }


def locks(arm: Arm, found: LockedReach, locked: int) -> dict[str, Any]:
    return {
        "method": "mapping",
        "why": LOCKED,
        "actuators": locked,
        "every": found.every,
        "impossible": found.impossible,
        "pixel": found.pixel,
        "free": figures(found.free),
        "mean": {name: finite(found.mean(name)) for name in FIGURES},
        "worst": {name: choice(arm, found.worst(name)) for name in FIGURES},
        "choices": [choice(arm, one) for one in found.choices],
    }


def figures(reach: Reach) -> dict[str, float | None]:
    return {name: finite(getattr(reach, name)) for name in FIGURES}


def choice(arm: Arm, reach: Reach) -> dict[str, Any]:
    """Returns the figures of one choice of locked actuators, and the locked states by label."""
    labels = zip(arm.manipulator.actuators, reach.locked.tolist(), strict=True)
    return {"locked": {label: STATES[state] for label, state in labels if state >= 0}, **figures(reach)}


def solver_of(arm: Arm, densities: Densities) -> Solver:
    from hyperbit.controller.search.solver import Solver

    solver = Solver(arm.reduced, densities, clearance=arm.clearance(arm.reduced))
    solver.prepare()
    return solver


def losses(found: Obstructed) -> dict[str, Any]:
    """Returns the figures of obstacles, as shares of the positions that the arm reaches without them."""
    count = len(found.positions)
    return {
        "method": "search",
        "positions": count,
        "reached": float(found.reached.mean()),
        "standard_error": found.error,
        "undecided": float((~found.proven).mean()),
        "inside": {name: number / count for name, number in found.inside.items()},
        "behind": {name: number / count for name, number in found.behind.items()},
    }


def finite(value: float) -> float | None:
    """Returns a number, or None if it is infinite: JSON has no infinity."""
    return value if math.isfinite(value) else None


def span(figure: dict[str, float], form: str) -> str:
    """Returns the limits of a figure as text; only one number if the form shows no difference."""
    lower, upper = form.format(figure["lower"]), form.format(figure["upper"])
    return lower if lower == upper else f"{lower}..{upper}"


def show(report: dict[str, Any]) -> None:
    own, mark = report["positions"], unit_mark(report["unit"])
    tolerance, kind = f"{report['tolerance']:g}{mark}", "area" if len(own["densest"]) == 2 else "volume"
    power = "" if not mark else f"{mark}²" if kind == "area" else f"{mark}³"
    console.print(
        f"{report['arm']}: 10^{own['log10_configurations']:.1f} configurations."
        f" {own['positions']} positions, by {own['method']}: {own['why']}.\n"
        f"{kind} with at least one configuration within {tolerance}: {span(own['covered'], '{:.3g}')}{power}\n"
        f"configurations within {tolerance}: median {span(own['log10_redundancy'], '10^{:.1f}')} over that {kind},"
        f" 10^{own['log10_greatest_redundancy']:.1f} near {shown(own['densest'])}{mark}."
        f"{'' if 'obstacles' in report else ' Obstacles are not considered: --obstacles does.'}"
    )
    if (among := report.get("obstacles")) is not None:
        console.print(
            f"among the obstacles: {among['reached']:.1%} of that {kind}, standard error {among['standard_error']:.1%},"
            f" by searches at {among['positions']} random positions; {among['undecided']:.1%} are not proven lost"
        )
        for name in sorted({*among["inside"], *among["behind"]}):
            inside, behind = among["inside"].get(name, 0.0), among["behind"].get(name, 0.0)
            console.print(f"  {name}: {inside:.1%} inside, {behind:.1%} behind it")
    if (at := report.get("at")) is not None:
        console.print(
            f"at {shown(at['position'])}{mark}, by {at['method']}: {at['why']}.\n"
            f"{at['configurations']:.4g} configurations within {tolerance},"
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
