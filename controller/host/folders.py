"""Folders of a user and of a service, and the folder of what outlives processes: ledger, journal, saved events."""

import os
import stat
from pathlib import Path

SIMULATED = "simulated"  # folder of simulated arms, below the folder of real ones


def user_folder(variable: str, usual: str) -> Path:
    """Returns a folder of the user: that of an environment variable, or a usual one below the home.

    A user without a home has a temporary folder; a reboot may delete it.
    """
    if (named := os.environ.get(variable)) is not None and named:
        return Path(named)
    try:
        return Path.home() / usual
    except RuntimeError:  # neither HOME nor an entry in the list of users
        return (private_folder("home") or Path("/nonexistent")) / usual


def private_folder(name: str) -> Path | None:
    import tempfile

    try:
        folder = Path(tempfile.gettempdir()) / f"hyperbit-{name}-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if own and writable(folder) else None


def writable(folder: Path) -> bool:
    """Returns whether a folder exists or can be created, and takes files, as numba tests it."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def state_folder(*, simulated: bool = False) -> Path:
    """Returns systemd's StateDirectory, or the user's state folder. Simulated arms have a folder of their own."""
    own = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    folder = Path(own) if own else user_folder("XDG_STATE_HOME", ".local/state") / "hyperbit"
    return folder / SIMULATED if simulated else folder
