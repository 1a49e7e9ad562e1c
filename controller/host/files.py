"""Files of unknown content: a reader bounds what it reads, and sets a damaged file of an earlier run aside."""

import errno
import glob
import io
import logging
import os
import stat
import time
from pathlib import Path
from typing import TypeVar

from hyperbit.controller.decoding.decoding import Unreadable, decode

T = TypeVar("T")

log = logging.getLogger(__name__)

MOST = 10_000_000  # bytes of a file that is read whole; readers of other files name their own limit
MOST_ASIDE = 3  # damaged files of one kind; the oldest are deleted
KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}


def open_file(path: Path, most: int | None = MOST) -> io.BufferedReader:
    """Opens a file to read it. A device or a pipe is refused before it is opened: it may have no end, or keep waiting.

    Args:
        path: of the file.
        most: most bytes that it may have; None: no limit, for what is read in pieces.

    Raises:
        OSError: the file cannot be read, is no regular file, or has more bytes; `strerror` is a sentence for users.
    """
    found = path.stat()
    if (kind := KINDS.get(stat.S_IFMT(found.st_mode))) is not None:
        number = errno.EISDIR if stat.S_ISDIR(found.st_mode) else errno.EINVAL
        raise OSError(number, f"it is {kind}, no file", str(path))
    if most is not None and found.st_size > most:
        raise too_large(path, most)
    return io.BufferedReader(io.FileIO(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)))


def read_file(path: Path, most: int = MOST) -> bytes:
    """Returns the content of a file of at most `most` bytes. Raises OSError as `open_file` does."""
    with open_file(path, most) as file:
        content = file.read(most + 1)
    if len(content) > most:  # it grew meanwhile, or tells no size
        raise too_large(path, most)
    return content


def too_large(path: Path, most: int) -> OSError:
    words = f"it has more than {most / 1e6:g} MB, the most for such a file; is it the right file?"
    return OSError(errno.EFBIG, words, str(path))


def set_aside(path: Path, why: object, then: str, *suffixes: str, kind: str | None = None) -> str | None:
    """Renames a damaged file of an earlier run, and logs it; the process goes on. Nothing is overwritten.

    The newest MOST_ASIDE damaged files of a kind stay.

    Args:
        path: of the file.
        why: what is wrong with it.
        then: what happens without it, for the log.
        suffixes: of further files that belong to it.
        kind: pattern of the names of files of this kind in the folder; None: of this name only.

    Returns:
        The logged sentence; None if the file cannot be renamed.
    """
    found = path.parent.glob(f"{kind or glob.escape(path.name)}.damaged-*")
    asides = sorted((int(aside.suffix[9:]), aside) for aside in found if aside.suffix[9:].isdecimal())
    stamp = max(time.time_ns(), asides[-1][0] + 1 if asides else 0)  # the clock may have been set back
    renamed = Path(f"{path}.damaged-{stamp}")
    try:
        for suffix in (*suffixes, ""):  # the file itself last: a kill before that leaves it in its place
            if os.path.lexists(part := f"{path}{suffix}"):
                os.rename(part, f"{renamed}{suffix}")
    except OSError as error:
        log.error("%s is damaged (%s), and cannot be renamed: %s", path, why, error.strerror)
        return None
    told = f"{path} was damaged ({why}), and renamed to {renamed.name}; {then}"
    log.error("%s", told)
    for _, old in asides[: 1 - MOST_ASIDE]:
        for suffix in (*suffixes, ""):
            Path(f"{old}{suffix}").unlink(missing_ok=True)
        log.warning("%s deleted: %d newer damaged files stay", old, MOST_ASIDE)
    return told


def read_kept(path: Path, kind: type[T], then: str) -> T | None:
    """Returns the JSON value that an earlier run kept in a file; None if the file is missing, or damaged and set aside.

    Args:
        path: of the file.
        kind: type of the value.
        then: what happens without a damaged file, for the log.
    """
    try:
        return decode(read_file(path), kind)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        set_aside(path, error.strerror, then)
    except Unreadable as error:
        set_aside(path, error, then)
    return None


def is_at(path: Path, descriptor: int) -> bool:
    """Returns whether an open file is still at its path: nobody has deleted, moved or replaced it."""
    try:
        there, opened = path.stat(), os.fstat(descriptor)
    except OSError:
        return False
    return (there.st_dev, there.st_ino) == (opened.st_dev, opened.st_ino)
