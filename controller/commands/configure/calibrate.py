"""The command `calibrate`: fits an arm's file to measured tips."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.saving import write_arm
from hyperbit.controller.armfile.documents import read_yaml
from hyperbit.controller.armfile.places import counted
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import ArmFile, AsJson, Dask, Workers
from hyperbit.controller.commands.common import (
    CommandFailed,
    check_output,
    console,
    print_json,
    print_table,
    results_table,
)
from hyperbit.controller.commands.sharing import checked_sharing, open_workers, progress_bar, spread_over

if TYPE_CHECKING:
    from hyperbit.controller.calibration.calibration import Calibration

RESIDUALS = ("before", "base_only", "after", "held_out", "held_out_base_only")  # of a calibration


def calibrate(
    file: ArmFile,
    samples: Annotated[
        Path,
        typer.Argument(
            metavar="SAMPLES.csv",
            help="Measured tips: column configuration or actuators, and x,y[,th] or x,y,z[,qx,qy,qz,qw].",
            show_default=False,
        ),
    ],
    out: Annotated[Path | None, typer.Option(metavar="NEW.yaml", help="File for the fitted arm.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    each: Annotated[bool, typer.Option("--each", help="Fit each module, and each leg of a truss, separately.")] = False,
    fit: Annotated[
        list[str] | None,
        typer.Option(metavar="PART", help="Fit base and this part: tip, modules[2] or modules[1].link; repeatable."),
    ] = None,
    base_only: Annotated[bool, typer.Option("--base-only", help="Fit the base only.")] = False,
    workers: Workers = 1,
    dask: Dask = None,
    as_json: AsJson = False,
) -> None:
    """Fit the modules and the base of an arm's file to measured tips; print the residuals before and after.

    `--workers` and `--dask` share the fits: one to all samples, and one without each fold. The numbers stay the same.
    """
    from hyperbit.controller.calibration.calibration import calibrated
    from hyperbit.controller.calibration.fit import CannotFit
    from hyperbit.controller.calibration.samples import read_samples

    if base_only and fit:
        raise InputFaults(Path("--base-only"), ["it fits the base alone: leave --fit out"])
    sharing = checked_sharing(workers, dask)
    arm = load(file)
    measured = read_samples(samples, arm.manipulator)
    if out is not None and out.exists() and not force:
        raise InputFaults(out, ["the file exists; name another file, or add --force"])
    if out is not None and arm.settings.wiring is not None and out.parent.resolve() != file.parent.resolve():
        raise InputFaults(out, [f"the new file needs {arm.settings.wiring} beside it, as {file} does: name one there"])
    if out is not None:
        check_output(out)
    try:
        with open_workers(sharing) as client, progress_bar("fits") as progress:
            spread = spread_over(client, progress, "fits", lambda mask: 1)
            found = calibrated(arm, measured, each=each, parts=[] if base_only else fit, spread=spread)
    except CannotFit as error:
        raise InputFaults(samples, [str(error)]) from None
    if out is not None and found.better:
        write(out, file, samples, found)
    if as_json:
        print_json({**payload(found), "out": str(out) if out and found.better else None})
    else:
        show(found, arm.settings.unit)
    if not found.better:
        raise CommandFailed(
            "on held-out samples the fitted numbers are no better than the file's"
            f"{'' if base_only else ' numbers with a fitted base'}; nothing is written"
        )


def write(out: Path, file: Path, samples: Path, found: Calibration) -> None:
    """Writes the fitted arm's file, after reading a draft of it back."""
    before, after = found.before.position.rms, found.after.position.rms
    comment = f"{file.name}, fitted to the {found.samples} tips in {samples.name}: rms {before:.3g}, now {after:.3g}."
    try:
        write_arm(out, {**read_yaml(file), **found.description}, comment)
    except InputFaults as error:
        raise CommandFailed(
            f"the fitted numbers describe no valid arm, nothing is written: {error.faults[0]}"
        ) from None
    except OSError as error:
        raise CommandFailed(f"{out} cannot be written: {error.strerror}") from None


def payload(found: Calibration) -> dict[str, Any]:
    changes = [
        {"field": change.parameter.path}
        | {name: getattr(change, name) for name in ("before", "after", "deviation", "determined")}
        for change in found.changes
    ]
    return {
        "samples": found.samples,
        "set_aside": list(found.outliers),
        **{name: asdict(getattr(found, name)) for name in RESIDUALS},
        "noise": found.noise.tolist(),
        "held_directions": found.undetermined,
        "better": found.better,
        "changes": changes,
    }


def show(found: Calibration, unit: str | None) -> None:
    lines = ", ".join(map(str, found.outliers))
    aside = f"; {len(found.outliers)} outliers set aside, lines {lines}" if found.outliers else ""
    console.print(f"{found.samples} samples{aside}")
    table = results_table("residuals", "", "rms", "95 %", "worst")
    units = {"position": f"position [{unit}]" if unit else "position", "orientation": "orientation [rad]"}
    for kind in ("position", "orientation"):
        for name in RESIDUALS:
            if (residuals := getattr(getattr(found, name), kind)) is not None:
                values = (residuals.rms, residuals.most, residuals.worst)
                table.add_row(units[kind], name.replace("_", " "), *(f"{value:.3g}" for value in values))
    print_table(table)
    table = results_table("field", "before", "after", "deviation", "")
    for change in found.changes:
        numbers = written(change.before), written(change.after), f"{change.deviation:.2g}"
        note = "" if change.determined else "not determined: kept near the file's value"
        table.add_row(counted(change.parameter.path), *numbers, note)
    print_table(table)
    if found.undetermined:
        console.print(
            f"In {found.undetermined} directions of the parameter space the samples determine the numbers less well"
            " than the file: two parameters compensate each other, or a state was not measured. There the fit keeps the"
            " file's values."
        )


def written(value: Any) -> str:
    return ", ".join(f"{part:.6g}" for part in value) if isinstance(value, list) else f"{value:.6g}"
