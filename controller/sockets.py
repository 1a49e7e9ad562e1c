"""Where the executors' sockets are: `<arm>.sock` in one of three folders."""

import os
from pathlib import Path

SYSTEM = Path("/run/hyperbit")  # of the service


def user_folder() -> Path:
    """Returns the folder of the sockets of executors that a person starts."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "hyperbit" if runtime else Path(f"/tmp/hyperbit-{os.getuid()}")


def default_socket(arm: str) -> Path:
    """Returns the path of the socket of an arm's executor, for the executor and its clients alike; creates nothing."""
    service = os.environ.get("RUNTIME_DIRECTORY")
    if service:
        return Path(service.split(":")[0]) / f"{arm}.sock"
    system = SYSTEM / f"{arm}.sock"
    if os.access(SYSTEM, os.W_OK) or system.exists():
        return system
    return user_folder() / f"{arm}.sock"


def found_sockets() -> list[Path]:
    """Returns the sockets of all executors, running or not, in the folders of `default_socket`."""
    service = os.environ.get("RUNTIME_DIRECTORY")
    folders = [Path(service.split(":")[0])] if service else []
    paths = [path for folder in [*folders, SYSTEM, user_folder()] for path in folder.glob("*.sock")]
    return sorted({path for path in paths if path.is_socket()})


def socket_path(path: Path | None, arm: str) -> Path:
    """Returns the path of an arm's socket where a user gave a path: of a socket, or of a folder; None: the default."""
    if path is None:
        return default_socket(arm)
    return path if path.suffix == ".sock" else path / f"{arm}.sock"
