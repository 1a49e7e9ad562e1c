"""A file of results, one line of JSON each, that one process writes."""

import errno
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from hyperbit.controller.host.files import is_at


def write_line(path: Path, file: IO[bytes], line: Mapping[str, Any]) -> bool:
    """Writes a line without the file's buffer, which would be written again when it is closed.

    Returns:
        Whether the file was deleted or moved, and is written again.

    Raises:
        OSError: it cannot be written.
    """
    data, gone = json.dumps(line).encode() + b"\n", not is_at(path, file.fileno())
    if gone:
        write_again(path, file)
    if os.write(file.fileno(), data) < len(data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return gone


def write_again(path: Path, file: IO[bytes]) -> None:
    """Copies an open file, which is no longer at its path, to this path; it then goes on there. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    number, done = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666), 0
    try:
        while data := os.pread(file.fileno(), 1 << 20, done):
            done += os.write(number, data)
        os.dup2(number, file.fileno(), inheritable=False)
    finally:
        os.close(number)
