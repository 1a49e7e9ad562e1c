"""The commands `fk`, `map` and `figure5`: forward kinematics, densities, and the paper's experiment."""

import time
from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.units import unit_mark
from hyperbit.controller.commands.arguments import ArmFile, AsJson, Picture
from hyperbit.controller.commands.common import (
    check_picture,
    configuration,
    console,
    densities_of,
    print_json,
    print_table,
    results_table,
    shipped,
    shown,
)
from hyperbit.controller.manipulator.notation import pose


def fk(
    file: ArmFile,
    states: Annotated[str, typer.Argument(metavar="CONFIGURATION", help="Module states, base first.")],
    as_json: AsJson = False,
) -> None:
    """Print position and orientation of the tip for a configuration."""
    arm = load(file)
    found = pose(arm.manipulator, arm.manipulator.tip(configuration(arm, states, "CONFIGURATION")))
    if as_json:
        print_json(found)
    else:
        place = f"{shown(found['position'])}{unit_mark(arm.settings.unit)}"
        console.print(f"position {place}  orientation {shown(found['orientation'])}")


def map(
    file: ArmFile,
    rebuild: Annotated[
        bool, typer.Option("--rebuild", help="Compute the densities even if the cache has them.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Compute the point densities of all intermediate workspaces and store them in the cache."""
    from hyperbit.controller.workspace.cache import default_directory

    arm = load(file)
    began = time.perf_counter()
    densities = densities_of(arm, rebuild=rebuild, silent=as_json)
    seconds = time.perf_counter() - began
    largest = int(densities.shapes.prod(axis=1).max())
    finest, coarsest = float(densities.pixels.min()), float(densities.pixels.max())
    megabytes, cache = densities.values.nbytes / 1e6, str(default_directory())
    if as_json:
        sizes = {"levels": len(densities.pixels), "pixel": [finest, coarsest], "largest_level": largest}
        print_json({**sizes, "megabytes": megabytes, "seconds": seconds, "cache": cache})
    else:
        console.print(
            f"{len(densities.pixels)} intermediate workspaces, pixel {finest:.4g} to {coarsest:.4g}, at most {largest}"
            f" pixels each, {megabytes:.1f} MB in {cache}, {seconds:.2f} s"
        )


def figure5(
    picture: Picture = Path("figure5.png"),
    as_json: AsJson = False,
) -> None:
    """Repeat the paper's experiment of section 4: three targets, three algorithms."""
    from hyperbit.controller.pictures.figure5 import experiment, save

    check_picture(picture)

    arm = load(shipped("planar16.yaml"))
    densities = densities_of(arm, silent=as_json)
    rows = experiment(arm, densities)
    save(picture, arm, densities, rows)
    table = results_table("method", "target", "configuration", "x", "y", "th", "error", "switches")
    for row in rows:
        if as_json:
            print_json({**row.__dict__, "picture": str(picture)})
        place = f"{row.x:.3f}", f"{row.y:.3f}", f"{row.theta:.3f}"
        target = f"{row.target[0]:g}, {row.target[1]:g}"
        table.add_row(row.method, target, row.configuration, *place, f"{row.error:.4f}", str(row.switches))
    if not as_json:
        print_table(table)
        console.print(f"picture: {picture}")
