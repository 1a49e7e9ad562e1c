"""Commands that tell whether file, boards and actuators are well: check and wear."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from controller.commands import common
from controller.commands.common import ArmFile, AsJson, Failed, print_json
from controller.strict import InputFaults

if TYPE_CHECKING:
    from controller.config import Arm

# StateDirectory of the service, and what it links to under DynamicUser, which root alone can read.
SERVICE_FOLDERS = (Path("/var/lib/hyperbit"), Path("/var/lib/private/hyperbit"))
INSTANCES = Path("/var/lib/hyperbit-arms")  # of the services by instance


def check(
    file: ArmFile,
    bus: Annotated[bool, typer.Option("--bus", help="Ask each board, too; changes nothing on it.")] = False,
    eds: Annotated[
        Path | None, typer.Option(help="The maker's data sheet of the boards (EDS): compare it, without a bus.")
    ] = None,
    node: Annotated[str | None, typer.Option(help="As in can0/5: the one board that the EDS is of.")] = None,
    as_json: AsJson = False,
) -> None:
    """Check an arm's file and name each fault by its field; --bus also reads the boards.

    Example: hyperbit check my-arm.yaml --eds 750-337.eds --node can0/5
    """
    from controller.config import load

    if node is not None and eds is None:
        raise InputFaults(Path("check"), ["--node is for --eds: give the file, too"])

    try:
        arm = load(file)
    except InputFaults as error:
        if as_json:
            print_json({"ok": False, "faults": list(error.faults)})
            raise typer.Exit(2) from None
        raise
    boards = compare(arm, eds, node) if eds is not None else []
    boards += ask_boards(arm) if bus else []
    missing = [f"{board['board']}: {board['answer']}" for board in boards if not board["ok"]]
    if as_json:
        print_json({"ok": not missing, "faults": missing, "boards": boards})
    else:
        count = len({(a.bus, a.node) for a in arm.wiring})
        common.console.print(
            f"{file}: arm {arm.settings.name}, {len(arm.manipulator.modules)} modules,"
            f" {len(arm.manipulator.actuators)} actuators on {count} boards: no fault"
        )
        for board in boards:
            common.console.print(f"  {board['board']}: {board['answer']}", style=None if board["ok"] else "red")
    if missing:
        if as_json:
            raise typer.Exit(1)
        raise Failed(f"{len(missing)} of {len(boards)} boards do not answer as they should, or lack what is needed")


def ask_boards(arm: Arm) -> list[dict[str, Any]]:
    """Returns what each board of an arm answers."""
    from controller.executor.arm import timing_of, wiring_of
    from drivers.canopen.faults import BusError
    from drivers.canopen.probe import probe

    try:
        answers = probe(wiring_of(arm.settings, arm.manipulator.actuators, arm.wiring), timing_of(arm.settings))
    except BusError as error:
        raise Failed(str(error)) from None
    return [{"board": answer.board, "ok": answer.ok, "answer": answer.text} for answer in answers]


def compare(arm: Arm, eds: Path, node: str | None) -> list[dict[str, Any]]:
    """Returns what each board of an arm lacks by an EDS; of one board alone if `node` names it.

    Raises:
        InputFaults: the file is no EDS, or the arm has no such board.
    """
    from controller.executor.arm import timing_of, wiring_of
    from drivers.canopen.eds_check import Eds, UnreadableEds, lacks
    from drivers.canopen.layout import lay_out

    wiring = wiring_of(arm.settings, arm.manipulator.actuators, arm.wiring)
    boards = {board.name: board for board in lay_out(wiring).boards}
    if node is not None and node not in boards:
        raise InputFaults(Path("--node"), [f"{node}: the arm has no such board, only {', '.join(boards)}"])
    answers = []
    for name, board in boards.items():
        if node in (None, name):
            try:
                found = lacks(Eds(eds, board.node), board, timing_of(arm.settings), wiring.error_state)
            except UnreadableEds as error:
                raise InputFaults(eds, [str(error)]) from None
            text = "; ".join(map(str, found)) or f"by {eds.name} it has all that is needed"
            answers.append({"board": name, "ok": not found, "answer": text, "lacks": [one._asdict() for one in found]})
    return answers


def wear(
    file: ArmFile,
    ledger: Annotated[Path | None, typer.Option(help="The ledger; the daemon's if absent.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print how often each actuator has switched, and how goals ended."""
    import sqlite3

    from rich.table import Table

    from controller.actuators import actuator_names, labels
    from controller.planning.ledger_file import default_path, read
    from controller.settings import read_settings

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
        raise Failed(f"{path}: no ledger there: {error}") from None
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
    """Returns the ledger that was written last, the first path if there is none.

    A ledger that this user cannot read is named on stderr.
    """
    times: dict[Path, float] = {}
    for path in ledgers:
        try:
            # SQLite writes to the -wal file first.
            parts = [part for part in (path, path.with_name(f"{path.name}-wal")) if part.is_file()]
            if path in parts:
                times[path] = max(part.stat().st_mtime for part in parts)
        except OSError as error:
            if os.path.lexists(path.parent):  # else there is no service, only /var/lib/private
                common.errors.print(f"{path}: {error.strerror}; root can read the service's ledger", markup=False)
    return max(times, key=lambda path: times[path], default=ledgers[0])
