"""Paths of the executors' sockets: `<arm>.sock` in the folder of an instance of the service, or of a user."""

import os
from pathlib import Path

INSTANCES = Path("/run/hyperbit-arms")  # folders of the services by instance


def user_folder() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "hyperbit" if runtime else Path(f"/tmp/hyperbit-{os.getuid()}")


def default_socket(arm: str, instances: Path = INSTANCES) -> Path:
    """Returns the path of the socket of an arm's executor, for the executor and its clients; creates nothing."""
    service = os.environ.get("RUNTIME_DIRECTORY")
    if service:
        return Path(service.split(":")[0]) / f"{arm}.sock"
    own = user_folder() / f"{arm}.sock"
    system = (folder / own.name for folder in instances.glob("*"))
    return next((path for path in system if os.path.exists(path)), own)  # False if unreadable for this user


def found_sockets(instances: Path = INSTANCES) -> list[Path]:
    """Returns the paths of all executors' sockets, running or not, in the folders of `default_socket`."""
    service = os.environ.get("RUNTIME_DIRECTORY")
    folders = [Path(service.split(":")[0])] if service else []
    folders += [*instances.glob("*"), user_folder()]
    paths = [path for folder in folders for path in folder.glob("*.sock")]
    return sorted({path for path in paths if path.is_socket()})


def socket_path(path: Path | None, arm: str) -> Path:
    """Returns the path of an arm's socket, given a path of a socket or of a folder; None: the default."""
    if path is None:
        return default_socket(arm)
    return path if path.suffix == ".sock" else path / f"{arm}.sock"
