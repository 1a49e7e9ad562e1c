"""The command `wear`: prints how often each actuator has switched."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import common
from hyperbit.controller.commands.arguments import ArmFile, AsJson
from hyperbit.controller.commands.common import CommandFailed, drawn, print_json

INSTANCES = Path("/var/lib/hyperbit-arms")  # state of the services by instance; links that only root can follow


def wear(
    file: ArmFile,
    ledger: Annotated[Path | None, typer.Option(help="Ledger to read. Default: the daemon's.")] = None,
    simulated: Annotated[bool, typer.Option("--simulated", help="Read the ledger of the simulated arm.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print how often each actuator has switched, and how goals ended."""
    import sqlite3

    from rich.table import Table

    from hyperbit.controller.planning.ledger_file import read

    name, actuators = name_and_labels(file)
    if simulated and ledger is not None:
        raise InputFaults(Path("wear"), ["give either --ledger or --simulated"])
    path = ledger or ledger_of(name, simulated=simulated)
    step = "name it by --ledger, run the daemon first, or read that of simulated boards by --simulated"
    try:
        switches, goals = read(path)
    except sqlite3.Error as error:
        raise CommandFailed(f"{path}: no ledger there: {error}", step) from None
    counts = {label: switches.get(label, 0) for label in actuators}
    if as_json:
        print_json({"ledger": str(path), "simulated": simulated, "switches": counts, "goals": goals})
        return
    common.console.print(f"ledger {path}{' of simulated boards' if simulated else ''}")
    most = max(max(counts.values()), 1)
    table = Table("actuator", "switches", "", title=f"{sum(counts.values())} switches, the most worn first")
    for label, count in sorted(counts.items(), key=lambda item: -item[1]):
        table.add_row(label, str(count), drawn("█", "#") * round(30 * count / most))
    common.print_table(table)
    ended = [str(goal["status"] or "unfinished") for goal in goals]
    common.console.print(
        ", ".join(f"{ended.count(status)} {status}" for status in sorted(set(ended))) or "no goals yet"
    )


def name_and_labels(file: Path) -> tuple[str, tuple[str, ...]]:
    from hyperbit.controller.armfile.actuators import actuator_names, labels
    from hyperbit.controller.armfile.settings import read_settings

    settings, faults = read_settings(file)
    actuators = labels(actuator_names(settings.modules, file.parent, faults))
    if faults:
        raise InputFaults(file, faults)
    return settings.name, actuators


def ledger_of(name: str, *, simulated: bool = False) -> Path:
    """Returns the path of an arm's ledger: of those of services and of this user the one that was written last.

    It is this user's path if there is none. Ledgers that the user cannot read are named.
    """
    from hyperbit.controller.host.folders import SIMULATED
    from hyperbit.controller.planning.ledger_file import default_path

    folders = [folder / SIMULATED if simulated else folder for folder in INSTANCES.glob("*/planner")]
    ledgers = [default_path(name, simulated=simulated), *(folder / f"{name}.sqlite" for folder in folders)]
    times: dict[Path, float] = {}
    for path in ledgers:
        try:
            # SQLite writes to the -wal file first.
            parts = [part for part in (path, path.with_name(f"{path.name}-wal")) if part.is_file()]
            if path in parts:
                times[path] = max(part.stat().st_mtime for part in parts)
        except OSError as error:
            common.errors.print(f"{path}: {error.strerror}; root can read the service's ledger")
    return max(times, key=lambda path: times[path], default=ledgers[0])
