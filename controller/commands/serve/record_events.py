"""The last events of planner and executor: `hyperbit record --events`."""

from __future__ import annotations

from pathlib import Path

from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.flight_recorder.keeper import KINDS, SHARED, RefusedFile, about, read_generation, save


def record_events(arm: str, folder: Path) -> tuple[list[Path], list[str]]:
    """Saves the last events of the processes of an arm that run on this computer.

    The events are read from memory, so that a process that hangs cannot refuse.

    Args:
        arm: its name.
        folder: of the new files.

    Returns:
        The files, one for each process, and sentences on what is missing.

    Raises:
        CommandFailed: a file cannot be written.
    """
    saved, missing = list[Path](), list[str]()
    for kind in KINDS:
        found, denied = _processes(arm, kind)
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


def _processes(arm: str, kind: str) -> tuple[list[list[Path]], bool]:
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
