"""The command `calibrate`: fits an arm's file to measured tips."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.armfile.commissioned import record_path
from hyperbit.controller.armfile.documents import read_text
from hyperbit.controller.armfile.places import counted
from hyperbit.controller.armfile.rewriting import rewritten
from hyperbit.controller.armfile.settings import files_beside
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.units import unit_name
from hyperbit.controller.calibration.model import Model
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmFile, AsJson, Connect, Dask, Workers, ZenohFile
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

MEASURE = (
    "Measure first: drive the arm to the configurations that tell most, and add tips to SAMPLES.csv until the held-out"
    " error no longer falls. SOURCE of a tip: prompt; measured_tip, from a tracker; or a CSV file that gets a row for"
    " each."
)
MOST = "With --measure: most samples."
PROPOSE = "Only print the next N configurations to measure, after those in SAMPLES.csv."
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
    measure: Annotated[str | None, typer.Option(metavar="SOURCE", help=MEASURE)] = None,
    most: Annotated[int, typer.Option(min=1, max=5000, help=MOST)] = 200,
    propose: Annotated[int | None, typer.Option(metavar="N", min=1, max=5000, help=PROPOSE)] = None,
    yes: Annotated[bool, typer.Option("--yes", help="With --measure: do not ask before the arm moves.")] = False,
    workers: Workers = 1,
    dask: Dask = None,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Fit the modules and the base of an arm's file to measured tips; print the residuals before and after.

    With `--measure` the samples are measured first, in configurations that tell most. `--workers` and `--dask` share
    the fits: one to all samples, and one without each fold. The numbers stay the same.
    """
    from hyperbit.controller.calibration.calibration import calibrated
    from hyperbit.controller.calibration.fit import CannotFit
    from hyperbit.controller.calibration.samples import read_samples
    from hyperbit.controller.commands.configure.calibrate_measure import measure as drive
    from hyperbit.controller.commands.configure.calibrate_measure import proposed

    if base_only and fit:
        raise InputFaults(Path("--base-only"), ["it fits the base alone: leave --fit out"])
    sharing, parts = checked_sharing(workers, dask), [] if base_only else fit
    arm = load(file)
    if out is not None and out.exists() and not force:
        raise InputFaults(out, ["the file exists; name another file, or add --force"])
    for table, copy in copies(file, out, arm) if out is not None else []:
        if copy.exists() and read_text(copy) != read_text(table):
            raise InputFaults(copy, [f"the file differs from {table}, which belongs beside the new file: move it away"])
    if out is not None:
        check_output(out)
    try:
        if propose is not None:
            known = read_samples(samples, arm.manipulator) if samples.exists() else None
            typer.echo("\n".join(proposed(arm, known, propose, each=each, parts=parts)))
            return
        with open_workers(sharing) as client, progress_bar("fits") as progress:
            spread = spread_over(client, progress, "fits", lambda mask: 1)
            if measure is not None:
                drive(arm, samples, measure, most, connect, zenoh_file, each=each, parts=parts, yes=yes, spread=spread)
            measured = read_samples(samples, arm.manipulator)
            found = calibrated(arm, measured, each=each, parts=parts, spread=spread)
    except CannotFit as error:
        raise InputFaults(samples, [str(error)]) from None
    if out is not None and found.better:
        write(out, file, samples, found, arm)
    if as_json:
        print_json({**payload(found), "out": str(out) if out and found.better else None})
    else:
        show(found, arm.settings.unit)
    if not found.better:
        raise CommandFailed(
            "on held-out samples the fitted numbers are no better than the file's"
            f"{'' if base_only else ' numbers with a fitted base'}; nothing is written"
        )


def write(out: Path, file: Path, samples: Path, found: Calibration, arm: Arm) -> None:
    """Writes the fitted arm's file with the comments and the order of the old one, after reading a draft of it back.

    A file that is there stays as NAME.old. The tables of the old file are copied beside the new one, and the record of
    its commission is, because the wiring is the same.
    """
    before, after = found.before.position.rms, found.after.position.rms
    text = f"# {file.name}, fitted to the {found.samples} tips in {samples.name}: rms {before:.3g}, now {after:.3g}.\n"
    text += rewritten(read_text(file), found.description, {change.parameter.where for change in found.changes})
    draft = out.with_name(f".{out.name}.{os.getpid()}")
    made = [(table, copy) for table, copy in copies(file, out, arm) if not copy.exists()]
    try:
        for table, copy in made:
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(table.read_bytes())
        draft.write_text(text, encoding="utf-8")
        check_tips(load(draft), arm, found)
        if out.exists():
            out.replace(out.with_name(f"{out.name}.old"))
        draft.replace(out)
        if record_path(file).exists() and not record_path(out).exists():
            record_path(out).write_bytes(record_path(file).read_bytes())
    except InputFaults as error:
        raise CommandFailed(
            f"the fitted numbers describe no valid arm, nothing is written: {error.faults[0]}"
        ) from None
    except OSError as error:
        raise CommandFailed(f"{out} cannot be written: {error.strerror}") from None
    finally:
        draft.unlink(missing_ok=True)


def copies(file: Path, out: Path, arm: Arm) -> list[tuple[Path, Path]]:
    """Returns the tables that an arm's file names, and their places beside a new file."""
    found = [(file.parent / name, out.parent / name) for name in files_beside(arm.settings)]
    return [(table, copy) for table, copy in found if table.resolve() != copy.resolve()]


def check_tips(new: Arm, old: Arm, found: Calibration) -> None:
    """Raises CommandFailed unless the tips of a new file are those that were fitted."""
    random = np.random.default_rng(0)
    some = np.column_stack([random.integers(0, count, 20) for count in old.manipulator.states])
    fitted = Model(found.description, ()).computed(some, oriented=False).tips
    if not np.allclose(new.manipulator.tips(some), fitted, rtol=0, atol=1e-7 * old.manipulator.length):
        raise CommandFailed("the new numbers do not fit into the layout of the arm's file; nothing is written")


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
    table = results_table(f"field [{unit_name(unit)}, rad]", "before", "after", "deviation", "")
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
