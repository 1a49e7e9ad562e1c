"""The command `record`: records what an arm publishes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import ArmName, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, arm_name
from hyperbit.controller.commands.connection import ENDPOINT
from hyperbit.controller.commands.serve.arm_process import ArmProcess, opened_session
from hyperbit.controller.commands.serve.recorder_process import can_log, new_recorder, opened_folder, record_messages

UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
SMALLEST = 100_000  # bytes; least value of --size and --keep

FOLDER = "Folder of the recordings; created if it is missing."
SIZE = "Begin a new recording after this size, such as 100M or 2G."
MINUTES = "Begin a new recording after this time [min]."
KEEP = "Delete the oldest recordings of this arm if all together exceed this size, such as 2G."
FSYNC = "Flush the data to disk each second: a power failure then loses at most one second."
EVENTS = "Save the last events of the arm's planner and executor on this computer, and end.."
CAN = "Also write the frames of the arm's buses as candump text; ARM must be the arm's file."


def record(
    arm: ArmName,
    folder: Annotated[Path, typer.Option(help=FOLDER)] = Path("recordings"),
    size: Annotated[str, typer.Option(metavar="BYTES", help=SIZE)] = "200M",
    minutes: Annotated[float, typer.Option(help=MINUTES)] = 60.0,
    keep: Annotated[str | None, typer.Option(metavar="BYTES", help=KEEP, show_default=False)] = None,
    fsync: Annotated[bool, typer.Option("--fsync", help=FSYNC)] = False,
    can: Annotated[bool, typer.Option("--can", help=CAN)] = False,
    events: Annotated[bool, typer.Option("--events", help=EVENTS)] = False,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
) -> None:
    """Record the messages of an arm, and the requests to it, to MCAP files until SIGTERM."""
    name = arm_name(arm)
    if events:
        save_events(name, folder)
        return
    limits = parse_size(size, "--size"), seconds_of(minutes)
    most_kept = None if keep is None else parse_size(keep, "--keep")
    require("mcap")
    process = ArmProcess(name)
    with opened_folder(folder, name, most_kept) as place, can_log(Path(arm) if can else None) as frames:
        process.notifier.notify("READY=1")
        with opened_session(connect, zenoh_file, process) as session:
            if session is not None:
                recorder = new_recorder(place, limits, frames, process, fsync=fsync)
                record_messages(session, recorder, frames, process)


def save_events(arm: str, folder: Path) -> None:
    """Saves the last events of planner and executor, and prints the paths of the files.

    Raises:
        CommandFailed: nothing was saved.
    """
    from hyperbit.controller.commands.serve.record_events import record_events

    saved, missing = record_events(arm, folder)
    for path in saved:
        typer.echo(str(path))
    if not saved:
        raise CommandFailed("; ".join(missing))
    for text in missing:
        typer.echo(text, err=True)


def seconds_of(minutes: float) -> float:
    """Returns the value of --minutes in seconds.

    Raises:
        InputFaults: the value is not above 0, or too large.
    """
    if not 0.0 < minutes < 1e6:
        raise InputFaults(Path("--minutes"), [f"a number above 0 is needed, got {minutes:g}"])
    return 60.0 * minutes


def parse_size(text: str, option: str) -> int:
    """Returns a size such as "200M" in bytes.

    Raises:
        InputFaults: the text is no size, or the size is too small for a recording.
    """
    unit = text[-1:].upper()
    number, factor = (text[:-1], UNITS[unit]) if unit in UNITS and unit else (text, 1)
    if not number.isascii() or not number.isdigit():
        raise InputFaults(Path(option), [f"{text!r}: a number of bytes is needed, such as 200M or 2G"])
    if (size := int(number) * factor) < SMALLEST:
        raise InputFaults(Path(option), [f"{text!r} is less than {SMALLEST} bytes"])
    return size


def require(package: str) -> None:
    """Checks that a package for recordings is installed.

    Raises:
        CommandFailed: the package is missing.
    """
    from importlib.util import find_spec

    if find_spec(package) is None:
        raise CommandFailed(f"the package {package} is missing", "install it with: pip install '.[recorder]'")
