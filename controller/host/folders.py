"""The folder in which processes keep what outlives them: ledger, switch journal, saved events."""

import os
from pathlib import Path

SIMULATED = "simulated"  # folder of simulated arms, below the folder of real ones


def state_folder(*, simulated: bool = False) -> Path:
    """Returns systemd's StateDirectory, otherwise the user's state folder.

    Args:
        simulated: whether the boards of the arm are simulated; such arms have a folder of their own.
    """
    own = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    folder = Path(own) if own else Path(base) / "hyperbit"
    return folder / SIMULATED if simulated else folder
