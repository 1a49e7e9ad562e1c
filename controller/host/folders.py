"""The folder for the persistent files of processes: ledger, switch journal, saved events."""

import os
from pathlib import Path

SIMULATED = "simulated"  # folder of simulated arms, below the folder of real ones


def state_folder(*, simulated: bool = False) -> Path:
    """Returns systemd's StateDirectory, or the user's state folder. Simulated arms have a folder of their own."""
    own = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    folder = Path(own) if own else Path(base) / "hyperbit"
    return folder / SIMULATED if simulated else folder
