"""A cache of densities on disk, so that a daemon is ready immediately after a restart."""

import hashlib
import logging
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hyperbit.controller.host.files import open_file, set_aside
from hyperbit.controller.host.folders import user_folder
from hyperbit.controller.host.keeper import whole_file
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities

log = logging.getLogger(__name__)

# Part of each key: increase it when the mapping or the format of the stored arrays changes.
FORMAT = 1


def default_directory() -> Path:
    """Returns the folder of the cache: systemd's CacheDirectory, otherwise in the user's cache folder."""
    if "CACHE_DIRECTORY" in os.environ:
        return Path(os.environ["CACHE_DIRECTORY"]) / "densities"
    return user_folder("XDG_CACHE_HOME", ".cache") / "hyperbit"


def key(manipulator: Manipulator, pixel: float, level_pixels: int) -> str:
    """Returns a digest of the input of the mapping: geometry and pixels, without the base frame."""
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
    """Returns the densities from the cache, or maps and stores them.

    A damaged or wrong file is set aside. The folder is created if needed. If it cannot be written, a warning is logged.
    For the arguments see map_densities; cached densities do not call `progress`.
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
    """Returns the densities in a file, or None if it is missing, damaged, or has another key than `wanted`."""
    try:
        with open_file(path, None) as file, np.load(file, allow_pickle=False) as archive:
            if (member := archive.zip.testzip()) is not None:
                raise ValueError(f"the checksum of {member} is wrong")
            if str(archive["key"]) != wanted:
                raise ValueError(f"it holds densities of {archive['key']}, not of {wanted}")
            densities = Densities(**{name: archive[name] for name in Densities.__dataclass_fields__})
    except FileNotFoundError:
        return None
    except OSError as error:
        log.warning("densities in %s cannot be read, they are built anew: %s", path, error.strerror)
        return None
    except Exception as error:  # damage can raise nearly anything; mapping again is safe
        set_aside(path, error, "its densities are built anew", kind="*.npz")
        return None
    return densities


def store(path: Path, wanted: str, densities: Densities) -> None:
    """Writes densities and their key atomically: a crash leaves the old file or the new one.

    Raises:
        OSError: the file cannot be written.
    """
    with whole_file(path) as file:
        np.savez(file, key=np.array(wanted), **vars(densities))
