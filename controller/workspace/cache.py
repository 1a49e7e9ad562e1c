"""Densities kept on disk, so that a daemon that restarts is ready at once."""

import hashlib
import logging
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from controller.manipulator.manipulator import Manipulator
from controller.workspace.densities import Densities
from controller.workspace.mapping import map_densities

log = logging.getLogger(__name__)

# Part of every key: raise it when mapping or the meaning of the stored arrays changes.
FORMAT = 1


def default_directory() -> Path:
    """Returns where caches go: systemd's CacheDirectory, else the user's cache folder."""
    if "CACHE_DIRECTORY" in os.environ:
        return Path(os.environ["CACHE_DIRECTORY"]) / "densities"
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "hyperbit"


def key(manipulator: Manipulator, pixel: float, level_pixels: int) -> str:
    """Returns a digest of all that the densities depend on: geometry and pixels, not the base frame."""
    digest = hashlib.sha256(f"{FORMAT} {pixel!r} {level_pixels} {manipulator.dimension}".encode())
    for array in (manipulator.states, manipulator.rotations, manipulator.translations):
        digest.update(repr(array.shape).encode() + array.tobytes())
    return digest.hexdigest()


def load_or_map(
    manipulator: Manipulator,
    pixel: float,
    level_pixels: int,
    directory: Path,
    progress: Callable[[int], None] = lambda levels: None,
) -> Densities:
    """Returns the densities from the cache, or maps them and puts them there.

    A file that is damaged or holds other densities is rebuilt; a folder that cannot be written is only warned of.

    Args:
        manipulator: the arm.
        pixel: see map_densities.
        level_pixels: see map_densities.
        directory: the cache's folder, made if need be.
        progress: see map_densities; not called when the cache serves.
    """
    wanted = key(manipulator, pixel, level_pixels)
    path = directory / f"{wanted[:24]}.npz"
    densities = load(path, wanted)
    if densities is None:
        densities = map_densities(manipulator, pixel, level_pixels, progress)
        try:
            store(path, wanted, densities)
        except OSError as error:
            log.warning("densities are not kept: %s cannot be written: %s", path, error)
    return densities


def load(path: Path, wanted: str) -> Densities | None:
    """Returns the densities in a file, or None if there are none, or others than those of the key `wanted`."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            if (member := archive.zip.testzip()) is not None:
                raise ValueError(f"the checksum of {member} is wrong")
            if str(archive["key"]) != wanted:
                raise ValueError(f"it holds densities of {archive['key']}, not of {wanted}")
            densities = Densities(**{name: archive[name] for name in Densities.__dataclass_fields__})
    except FileNotFoundError:
        return None
    except Exception as error:  # damage can surface as nearly anything, and is no more than lost time
        log.warning("densities in %s are built anew: %s", path, error)
        return None
    return densities


def store(path: Path, wanted: str, densities: Densities) -> None:
    """Writes densities and their key so that a crash leaves the old file or the new one, never half of one.

    Raises:
        OSError: the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            np.savez(file, key=np.array(wanted), **vars(densities))
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
