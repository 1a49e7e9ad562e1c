"""The process of the command `record`: folder, buses, and the loop that records."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.serve.arm_process import ArmProcess

if TYPE_CHECKING:
    import zenoh

    from hyperbit.controller.recorder.can_log import CanLog
    from hyperbit.controller.recorder.folder import Folder
    from hyperbit.controller.recorder.recorder import Recorder

FLUSH_EVERY = 1.0  # [s] between two writes of frames


def record_messages(session: zenoh.Session, recorder: Recorder, frames: CanLog | None, process: ArmProcess) -> None:
    """Records the messages of the arm, and writes its frames once a second, until the process is to end."""
    from hyperbit.controller.network.listener import Listener

    flushed = time.monotonic()

    def beat() -> None:
        nonlocal flushed
        process.feed_watchdog()
        if frames is not None and time.monotonic() >= flushed + FLUSH_EVERY:
            flushed = time.monotonic()
            frames.flush()

    with contextlib.ExitStack() as stack:
        stack.callback(recorder.end_recording)
        listener = stack.enter_context(contextlib.closing(Listener(session, process.arm)))
        recorder.run(listener, process.ending.is_set, beat)
        process.notifier.notify("STOPPING=1")


@contextlib.contextmanager
def opened_folder(path: Path, arm: str, most: int | None) -> Iterator[Folder]:
    """Opens the folder of an arm's recordings; `most` limits the bytes of all.

    Raises:
        CommandFailed: another recorder uses the folder, or the folder cannot be written.
    """
    from hyperbit.controller.recorder.folder import Folder, FolderInUse

    try:
        folder = Folder(path, arm, most)
    except FolderInUse as error:
        raise CommandFailed(str(error)) from None
    except OSError as error:
        raise CommandFailed(f"{path}: recordings cannot be written: {error.strerror}") from None
    with contextlib.closing(folder):
        yield folder


@contextlib.contextmanager
def can_log(file: Path | None) -> Iterator[CanLog | None]:
    """Opens the buses of an arm's file for a log of their frames; None: there is no log.

    Raises:
        InputFaults: the file is missing or wrong.
    """
    if file is None:
        yield None
        return
    if not file.is_file():
        raise InputFaults(Path("--can"), [f"{file}: no such file; --can needs the arm's file, which names its buses"])
    from hyperbit.controller.armfile.actuators import read_wired
    from hyperbit.controller.recorder.can_log import CanLog

    settings, _, _ = read_wired(file)
    with contextlib.closing(CanLog(settings.buses)) as frames:
        yield frames


def new_recorder(
    folder: Folder, limits: tuple[int, float], frames: CanLog | None, process: ArmProcess, *, fsync: bool
) -> Recorder:
    """Returns a recorder. The log of the frames continues beside each new recording.

    Args:
        folder: of the recordings.
        limits: most bytes, and longest time [s], of one recording.
        frames: log of the frames; None: there is no log.
        process: of the recorder.
        fsync: whether each flush waits for the disk.
    """
    from hyperbit.controller.recorder.folder import CAN_LOG
    from hyperbit.controller.recorder.recorder import Limits, Recorder

    def began(recording: Path) -> None:
        if frames is not None:
            frames.begin(recording.with_suffix(CAN_LOG))

    return Recorder(process.arm, folder, Limits(*limits), fsync=fsync, began=began)
