"""Marks of published results, so that a planner that is killed does not publish a result again.

The executor sends a result again until the planner acknowledges it. The planner publishes it, marks it as published,
and acknowledges it later. If the planner is killed meanwhile, the next one finds the mark in a file in memory. The file
needs no fsync: it survives the death of the process, and a reboot deletes the executor's results as well.
"""

import errno
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from controller.planning.core.events import Identity
from controller.planning.ledger_file import plain

log = logging.getLogger(__name__)

MOST_MARKS = 1_000  # the executor stores no more results


class Mark(NamedTuple):
    """A published result, one JSON array in a line.

    Attributes:
        instance: of the executor.
        program: number of the program.
        status: of the result.
        code: of the result.
        message: of the result.
        switches: of all actuators.
    """

    instance: int
    program: int
    status: str
    code: int
    message: str
    switches: int


class PublishedResults:
    """The newest published results, in memory and in a file. After the start for one thread, the outbox's.

    The file has at most twice MOST_MARKS lines. Lines that are torn, or are no marks, are ignored.

    Args:
        path: of the file, in a folder in memory, which must exist.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._warned = path, False
        try:
            content = path.read_bytes()
        except OSError:  # the first start
            content = b""
        self._torn = bool(content) and not content.endswith(b"\n")
        self._lines = content.count(b"\n")
        self._marks = {Identity(*mark[:2]): mark for mark in map(decoded, content.splitlines()) if mark is not None}

    def known(self) -> frozenset[Identity]:
        """Returns the programs whose results were published."""
        return frozenset(self._marks)

    def find(self, identity: Identity) -> Mark | None:
        """Returns the published result of a program, None if there is none."""
        return self._marks.get(identity)

    def add(self, identity: Identity, payload: Mapping[str, Any]) -> None:
        """Notes a result as published, in about 10 us. If the file cannot be written, the note is in memory only."""
        words = plain(str(payload.get("message", "")))
        mark = Mark(*identity, payload.get("status", ""), payload.get("code", 0), words, payload.get("switches", 0))
        self._marks[identity] = mark
        if len(self._marks) > 2 * MOST_MARKS:
            self._keep(list(self._marks.values())[-MOST_MARKS:])
        elif self._write(self._path, os.O_APPEND, b"\n" * self._torn + encoded(mark)):
            self._lines += 1

    def keep(self, instance: int) -> None:
        """Drops the results of other executors if the file has more than MOST_MARKS lines."""
        if self._lines > MOST_MARKS:
            self._keep([mark for mark in self._marks.values() if mark.instance == instance])

    def _keep(self, marks: list[Mark]) -> None:
        """Replaces the file."""
        self._marks = {Identity(*mark[:2]): mark for mark in marks}
        new = self._path.with_name(f"{self._path.name}.new")
        if self._write(new, os.O_TRUNC, b"".join(map(encoded, marks)), self._path):
            self._lines = len(marks)

    def _write(self, path: Path, flag: int, data: bytes, target: Path | None = None) -> bool:
        """Writes data at once, and renames the file to `target`; returns whether that succeeded.

        The file is opened each time: systemd may have deleted the folder with an executor, and made it again.
        """
        try:
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | flag, 0o600)
            try:
                self._torn = os.write(file, data) < len(data)
            finally:
                os.close(file)
            if self._torn:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            if target is not None:
                os.replace(path, target)
            return True
        except OSError as error:
            if not self._warned:
                log.warning("%s: %s; a planner that is killed may publish a result twice", path, error.strerror)
            self._warned = True
            return False


def published_path(arm: str, socket: Path) -> Path:
    """Returns the path of an arm's marks: in systemd's RuntimeDirectory, otherwise beside the executor's socket."""
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return (Path(folder) if folder else socket.parent) / f"{arm}.published"


def encoded(mark: Mark) -> bytes:
    """Returns the line of a mark."""
    return msgspec.json.encode(mark) + b"\n"


def decoded(line: bytes) -> Mark | None:
    """Returns the mark of a line, None if the line has none."""
    try:
        return msgspec.json.decode(line, type=Mark)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
