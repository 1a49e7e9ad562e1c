"""The command `record`: records what an arm publishes, and with --events the last events of its processes."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmName, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, arm_name
from hyperbit.controller.commands.process import Process, opened_session
from hyperbit.controller.host.keeper import KINDS, SHARED, FileInUse, RefusedFile, about, read_generation, save

if TYPE_CHECKING:
    from hyperbit.controller.recorder.can_log import CanLog
    from hyperbit.controller.recorder.folder import Folder

UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
SMALLEST = 100_000  # bytes; least value of --size and --keep

FLUSH_EVERY = 1.0  # [s] between two writes of frames

FOLDER = "Folder of the recordings; created if it is missing."
SIZE = "Begin a new recording after this size, such as 100M or 2G."
MINUTES = "Begin a new recording after this time [min]."
KEEP = "Delete the oldest recordings of this arm if all together exceed this size, such as 2G."
FSYNC = "Flush the data to disk each second: a power failure then loses at most one second."
EVENTS = "Save the last events of the arm's planner and executor on this computer, and end."
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
        print_events(*record_events(name, folder))
        return
    if not 0.0 < minutes < 1e6:
        raise InputFaults(Path("--minutes"), [f"a number above 0 is needed, got {minutes:g}"])
    limits = parse_size(size, "--size"), 60.0 * minutes
    most_kept = None if keep is None else parse_size(keep, "--keep")
    require("mcap")
    process = Process(name)
    with contextlib.ExitStack() as stack:
        place = stack.enter_context(opened_folder(folder, name, most_kept))
        frames = stack.enter_context(can_log(Path(arm))) if can else None
        process.notifier.notify("READY=1")
        if (session := stack.enter_context(opened_session(connect, zenoh_file, process))) is None:
            return
        from hyperbit.controller.network.listener import Listener
        from hyperbit.controller.recorder.folder import CAN_LOG
        from hyperbit.controller.recorder.recorder import Limits, Recorder

        flushed = time.monotonic()

        def began(recording: Path) -> None:
            if frames is not None:
                frames.begin(recording.with_suffix(CAN_LOG))

        def beat() -> None:
            nonlocal flushed
            process.feed_watchdog()
            if frames is not None and time.monotonic() >= flushed + FLUSH_EVERY:
                flushed = time.monotonic()
                frames.flush()

        recorder = Recorder(name, place, Limits(*limits), fsync=fsync, began=began)
        stack.callback(recorder.end_recording)
        listener = stack.enter_context(contextlib.closing(Listener(session, name)))
        recorder.run(listener, process.ending.is_set, beat)
        process.notifier.notify("STOPPING=1")


def parse_size(text: str, option: str) -> int:
    """Returns a size such as "200M" in bytes."""
    unit = text[-1:].upper()
    number, factor = (text[:-1], UNITS[unit]) if unit in UNITS and unit else (text, 1)
    if not number.isascii() or not number.isdigit():
        raise InputFaults(Path(option), [f"{text!r}: a number of bytes is needed, such as 200M or 2G"])
    if (size := int(number) * factor) < SMALLEST:
        raise InputFaults(Path(option), [f"{text!r} is less than {SMALLEST} bytes"])
    return size


def require(package: str) -> None:
    from importlib.util import find_spec

    if find_spec(package) is None:
        raise CommandFailed(f"the package {package} is missing", "install it with: pip install '.[recorder]'")


@contextlib.contextmanager
def opened_folder(path: Path, arm: str, most: int | None) -> Iterator[Folder]:
    """Opens the folder of an arm's recordings; `most` limits the bytes of all."""
    from hyperbit.controller.recorder.folder import Folder

    try:
        folder = Folder(path, arm, most)
    except FileInUse as error:
        raise CommandFailed(str(error)) from None
    except OSError as error:
        raise CommandFailed(f"{path}: recordings cannot be written: {error.strerror}") from None
    with contextlib.closing(folder):
        yield folder


@contextlib.contextmanager
def can_log(file: Path) -> Iterator[CanLog]:
    """Opens the buses of an arm's file for a log of their frames."""
    if not file.is_file():
        raise InputFaults(Path("--can"), [f"{file}: no such file; --can needs the arm's file, which names its buses"])
    from hyperbit.controller.armfile.actuators import read_wired
    from hyperbit.controller.recorder.can_log import CanLog

    settings, _, _ = read_wired(file)
    with contextlib.closing(CanLog(settings.buses)) as frames:
        yield frames


def print_events(saved: list[Path], missing: list[str]) -> None:
    for path in saved:
        typer.echo(str(path))
    if not saved:
        raise CommandFailed("; ".join(missing))
    for text in missing:
        typer.echo(text, err=True)


def record_events(arm: str, folder: Path) -> tuple[list[Path], list[str]]:
    """Saves the last events of the processes of an arm that run on this computer.

    The events are read from memory, so that a process that hangs cannot refuse.

    Returns:
        The files, one for each process, and sentences on what is missing.
    """
    saved, missing = list[Path](), list[str]()
    for kind in KINDS:
        found, denied = generations(arm, kind)
        for paths in found:
            try:
                saved.append(save(paths, folder, "request"))
            except RefusedFile as error:
                missing.append(f"the events of the {kind} cannot be read: {error}")
            except OSError as error:
                raise CommandFailed(f"{folder}: events cannot be written: {error.strerror or error}") from None
        if denied:
            missing.append(f"the {kind} runs as another user: use sudo, or log in as this user")
        elif not found:
            missing.append(f"no {kind} of arm {arm} records events on this computer: none runs here")
    return saved, missing


def generations(arm: str, kind: str) -> tuple[list[list[Path]], bool]:
    """Returns the generations in memory of each process of a kind, and whether there are some of another user."""
    groups: dict[str, list[Path]] = {}
    denied = False
    for path in sorted(SHARED.glob(f"hyperbit-*-{arm}-{kind}-*.events")):
        try:
            content = read_generation(path)
            mine = bool(content) and about(content)["arm"] == arm
        except RefusedFile:
            mine = False
        except OSError:
            denied, mine = True, False
        if mine:
            groups.setdefault(path.name.split(".")[0], []).append(path)
    return list(groups.values()), denied
