"""The command `record`: records what an arm publishes."""

from __future__ import annotations

import contextlib
import logging
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller.armfile.strict import InputFaults
from controller.commands.common import ENDPOINT, ArmName, CommandFailed, Connect, ZenohFile, arm_name

if TYPE_CHECKING:
    import zenoh

    from controller.recorder.can_log import CanLog

RETRY = 1.0  # [s] between attempts to reach the daemon
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
    most, most_kept = parse_size(size, "--size"), None if keep is None else parse_size(keep, "--keep")
    if not 0.0 < minutes < 1e6:
        raise InputFaults(Path("--minutes"), [f"a number above 0 is needed, got {minutes:g}"])
    require("mcap")

    from controller.host.journal import start_logging
    from controller.host.notify import Notifier
    from controller.recorder.folder import CAN_LOG, Folder, FolderInUse
    from controller.recorder.listener import Listener
    from controller.recorder.recorder import Limits, Recorder

    start_logging({"HYPERBIT_ARM": name})
    ending, notifier = threading.Event(), Notifier()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ending.set())
    with contextlib.ExitStack() as stack:
        try:
            where = Folder(folder, name, most_kept)
        except FolderInUse as error:
            raise CommandFailed(str(error)) from None
        except OSError as error:
            raise CommandFailed(f"{folder}: recordings cannot be written: {error.strerror}") from None
        stack.callback(where.close)
        frames = can_log(Path(arm)) if can else None
        if frames is not None:
            stack.callback(frames.close)

        def began(path: Path) -> None:
            if frames is not None:
                frames.begin(path.with_suffix(CAN_LOG))

        notifier.send("READY=1")
        session = stack.enter_context(opened(connect, zenoh_file, ending.wait, lambda: notifier.send("WATCHDOG=1")))
        if session is None:
            return
        recorder = Recorder(name, where, Limits(most, minutes * 60.0), fsync=fsync, began=began)
        stack.callback(recorder.end_recording)
        listener = Listener(session, name)
        stack.callback(listener.close)
        flushed = time.monotonic()

        def beat() -> None:
            nonlocal flushed
            notifier.send("WATCHDOG=1")
            if frames is not None and time.monotonic() >= flushed + 1.0:
                flushed = time.monotonic()
                frames.flush()

        recorder.run(listener, ending.is_set, beat)
        notifier.send("STOPPING=1")


def save_events(arm: str, folder: Path) -> None:
    """Saves the last events of planner and executor, and prints the paths of the files.

    Raises:
        CommandFailed: nothing was saved.
    """
    from controller.commands.use.record_events import record_events

    saved, missing = record_events(arm, folder)
    for path in saved:
        typer.echo(str(path))
    if not saved:
        raise CommandFailed("; ".join(missing))
    for text in missing:
        typer.echo(text, err=True)


@contextlib.contextmanager
def opened(
    connect: str, zenoh_file: Path | None, wait: Callable[[float], bool], beat: Callable[[], None]
) -> Iterator[zenoh.Session | None]:
    """Opens a session with a daemon as soon as one is there.

    Args:
        connect: Zenoh endpoint of the daemon.
        zenoh_file: Zenoh configuration, instead of the endpoint.
        wait: waits for a time [s]; returns whether the command is to end.
        beat: called before each wait.

    Yields:
        The session, or None if the command is to end before a daemon was there.

    Raises:
        InputFaults: the Zenoh configuration is wrong.
    """
    import zenoh

    from controller.network import session

    zenoh.init_log_from_env_or("error")
    warned = False
    while True:
        try:
            config = session.from_file(zenoh_file) if zenoh_file else session.configuration("client", connect=connect)
        except ValueError as error:
            raise InputFaults(Path("--zenoh"), [str(error)]) from None
        try:
            live = zenoh.open(config)
            break
        except zenoh.ZError as error:
            if not warned:
                warned = True
                where, why = zenoh_file or connect, session.reason(error)
                logging.getLogger(__name__).warning("no daemon at %s yet, waiting for one: %s", where, why)
        beat()
        if wait(RETRY):
            yield None
            return
    with live:
        yield live


def can_log(file: Path) -> CanLog:
    """Opens the buses of an arm's file for a log of their frames.

    Raises:
        InputFaults: the file is missing or wrong.
    """
    if not file.is_file():
        raise InputFaults(Path("--can"), [f"{file}: no such file; --can needs the arm's file, which names its buses"])
    from controller.armfile.actuators import read_wired
    from controller.recorder.can_log import CanLog

    settings, _, _ = read_wired(file)
    return CanLog(settings.buses)


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
