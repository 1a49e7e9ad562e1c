"""The command `workspace`: draws and reports where an arm can reach."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from controller.arm.arm import Arm, load
from controller.armfile.strict import InputFaults
from controller.commands.common import (
    ArmFile,
    AsJson,
    console,
    densities_of,
    errors,
    parse_goal,
    print_json,
    results_table,
    shown,
)
from controller.manipulator.frames import quaternion
from controller.manipulator.locked import STATES

if TYPE_CHECKING:
    from controller.workspace.densities import Densities
    from controller.workspace.locked_reach import LockedReach, Reach
    from controller.workspace.orientations import Orientations

FIGURES = ("reach", "covered", "redundancy")
DRAWN = "random draws, weighted by the Mapping Algorithm's densities; a grid over orientations would be far too coarse"
MAPPED = "the search uses the same densities of all intermediate workspaces"
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
    tolerance: Annotated[float | None, typer.Option(help="Position tolerance. Default: the arm's.")] = None,
    picture: Annotated[Path, typer.Option(help="File for the picture.")] = Path("workspace.png"),
    seed: Annotated[int, typer.Option(help="Seed of random draws and choices.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Draw and report where an arm can reach: positions, orientations at a point, reach with locked actuators."""
    from controller.pictures.workspace_plots import draw_workspace, locked_field, positions_field
    from controller.workspace.orientations import orientations_at

    arm = load(file)
    own = arm.tolerance if tolerance is None else tolerance
    if not 1e-9 <= own <= 1e6:
        raise InputFaults(Path("--tolerance"), [f"{own:g} is no length from 1e-9 to 1e6"])
    if not 1 <= samples <= 10_000:
        raise InputFaults(Path("--samples"), [f"{samples} is not from 1 to 10000"])
    point = None if at is None else position(at, arm.manipulator.dimension)
    densities = densities_of(arm, silent=as_json)
    report: dict[str, Any] = {"arm": arm.settings.name, "tolerance": own, "positions": positions(arm, densities, own)}
    fields = [positions_field(densities, arm.manipulator.dimension, own)]
    found = None if point is None else orientations_at(arm.reduced, densities, point, own, seed=seed)
    if found is not None:
        report["at"] = {"position": point, **orientations(found, planar=arm.manipulator.planar)}
    if locked is not None:
        choices = locked_reach(arm, densities, locked, own, samples, seed, silent=as_json)
        report["locked"] = locks(arm, choices, locked)
        fields.append(locked_field(choices, locked))
    some = found if found is not None and len(found.counts) else None
    try:
        draw_workspace(arm.reduced, fields, point, some, arm.settings.name).savefig(picture, dpi=130)
    except (OSError, ValueError) as error:
        raise InputFaults(picture, [f"cannot be written: {error}"]) from None
    report["picture"] = str(picture)
    if as_json:
        print_json(report)
    else:
        show(report)


def position(text: str, dimension: int) -> list[float]:
    """Parses the position of `--at`.

    Raises:
        InputFaults: the text is no position.
    """
    found, orientation = parse_goal(text, dimension, "--at")
    if orientation is not None:
        raise InputFaults(Path("--at"), [f"{text!r}: a position of {dimension} numbers is needed"])
    return found


def locked_reach(
    arm: Arm, densities: Densities, locked: int, tolerance: float, samples: int, seed: int, *, silent: bool
) -> LockedReach:
    """Returns the reach with locked actuators; shows a progress bar on stderr.

    Raises:
        InputFaults: the arm has too few actuators to lock.
    """
    from rich.progress import Progress

    from controller.workspace.locked_reach import reach_when_locked

    with Progress(console=errors, transient=True, disable=silent or not errors.is_terminal) as progress:
        task = progress.add_task("mapping arms with locked actuators", total=None)
        try:
            return reach_when_locked(
                arm.reduced,
                densities,
                locked,
                tolerance,
                samples,
                seed,
                lambda done, total: progress.update(task, completed=done, total=total),
            )
        except ValueError as error:
            raise InputFaults(Path("--locked"), [str(error)]) from None


def positions(arm: Arm, densities: Densities, tolerance: float) -> dict[str, Any]:
    """Returns the figures of the density of positions."""
    planar, dimension = arm.manipulator.planar, arm.manipulator.dimension
    values, pixel = densities.level(0).astype(float), float(densities.pixels[0])
    some = values[values >= 0]
    ball = math.pi * tolerance**2 if planar else 4 / 3 * math.pi * tolerance**3
    within = (some + math.log(ball / pixel**dimension)) / math.log(10)
    covered = within[within >= 0]
    z, y, x = np.unravel_index(int(values.argmax()), values.shape)
    densest = arm.reduced.base @ np.append(densities.references[0] + pixel * np.array([x, y, z]), 1.0)
    return {
        "method": "mapping",
        "why": MAPPED,
        "pixel": pixel,
        "configurations": float(np.log10(arm.reduced.states).sum()),
        "reach": len(some) * pixel**dimension,
        "covered": len(covered) * pixel**dimension,
        "redundancy": float(np.median(covered)) if len(covered) else None,
        "greatest_redundancy": float(within.max()),
        "densest": densest[:dimension].tolist(),
    }


def orientations(found: Orientations, *, planar: bool) -> dict[str, Any]:
    """Returns the figures of the density of orientations at a point."""
    from controller.pictures.workspace_plots import angles_of, arcs, directions, twists

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
    """Returns the figures of reach and redundancy with locked actuators."""
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
    """Returns the figures of one choice of locked actuators."""
    return {name: finite(getattr(reach, name)) for name in FIGURES}


def choice(arm: Arm, reach: Reach) -> dict[str, Any]:
    """Returns the figures of one choice of locked actuators, and the locked states by label."""
    labels = zip(arm.manipulator.actuators, reach.locked.tolist(), strict=True)
    return {"locked": {label: STATES[state] for label, state in labels if state >= 0}, **figures(reach)}


def finite(value: float) -> float | None:
    """Returns a number, or None if it is infinite: JSON has no infinity."""
    return value if math.isfinite(value) else None


def power(exponent: float | None) -> str:
    """Returns a power of ten as text."""
    return "none" if exponent is None else f"10^{exponent:.1f}"


def show(report: dict[str, Any]) -> None:
    """Prints the figures."""
    own, tolerance = report["positions"], report["tolerance"]
    kind = "area" if len(own["densest"]) == 2 else "volume"
    console.print(
        f"{report['arm']}: 10^{own['configurations']:.1f} configurations, by {own['method']}: {own['why']}.\n"
        f"reach: {kind} {own['reach']:.4g}; {own['covered']:.4g} with at least one configuration within {tolerance:g}\n"
        f"redundancy: {power(own['redundancy'])} configurations within {tolerance:g} (median of these),"
        f" {power(own['greatest_redundancy'])} near {shown(own['densest'])}. Obstacles are not considered."
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
        console.print(table)
        console.print("redundancy: log10 of configurations within the tolerance, median over the free arm's coverage")
    console.print(f"picture: {report['picture']}")
