"""The command `wear`: prints how often each actuator has switched."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from controller.armfile.strict import InputFaults
from controller.commands import common
from controller.commands.common import ArmFile, AsJson, CommandFailed, print_json

# StateDirectory of the service, and its link target under DynamicUser, which only root can read.
SERVICE_FOLDERS = (Path("/var/lib/hyperbit"), Path("/var/lib/private/hyperbit"))
INSTANCES = Path("/var/lib/hyperbit-arms")  # of the services by instance


def wear(
    file: ArmFile,
    ledger: Annotated[Path | None, typer.Option(help="Ledger to read. Default: the daemon's.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print how often each actuator has switched, and how goals ended."""
    import sqlite3

    from rich.table import Table

    from controller.armfile.actuators import actuator_names, labels
    from controller.armfile.settings import read_settings
    from controller.planning.ledger_file import default_path, read

    settings, faults = read_settings(file)
    actuators = labels(actuator_names(settings.modules, file.parent, faults))
    if faults:
        raise InputFaults(file, faults)
    name = settings.name
    services = [*SERVICE_FOLDERS, *(instance / "planner" for instance in INSTANCES.glob("*"))]
    path = ledger or last_written([default_path(name), *(folder / f"{name}.sqlite" for folder in services)])
    try:
        switches, goals = read(path)
    except sqlite3.Error as error:
        raise CommandFailed(
            f"{path}: no ledger there: {error}", "name it by --ledger, or run the daemon first"
        ) from None
    counts = {label: switches.get(label, 0) for label in actuators}
    if as_json:
        print_json({"ledger": str(path), "switches": counts, "goals": goals})
        return
    common.console.print(f"ledger {path}", markup=False)
    most = max(max(counts.values()), 1)
    table = Table("actuator", "switches", "", title=f"{sum(counts.values())} switches, the most worn first")
    for label, count in sorted(counts.items(), key=lambda item: -item[1]):
        table.add_row(label, str(count), "█" * round(30 * count / most))
    common.console.print(table)
    ended = [str(goal["status"] or "unfinished") for goal in goals]
    common.console.print(
        ", ".join(f"{ended.count(status)} {status}" for status in sorted(set(ended))) or "no goals yet"
    )


def last_written(ledgers: list[Path]) -> Path:
    """Returns the ledger that was written last; the first path if none exists.

    This function names ledgers that the user cannot read on stderr.
    """
    times: dict[Path, float] = {}
    for path in ledgers:
        try:
            # SQLite writes to the -wal file first.
            parts = [part for part in (path, path.with_name(f"{path.name}-wal")) if part.is_file()]
            if path in parts:
                times[path] = max(part.stat().st_mtime for part in parts)
        except OSError as error:
            if os.path.lexists(path.parent):  # otherwise no service is installed, and only /var/lib/private exists
                common.errors.print(f"{path}: {error.strerror}; root can read the service's ledger", markup=False)
    return max(times, key=lambda path: times[path], default=ledgers[0])
