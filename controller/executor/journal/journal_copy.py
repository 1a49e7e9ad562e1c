"""Copies the switch journal from a file in memory to the disk: the executor's copier, a process of its own.

A write to a disk can take seconds, and a thread would take the interpreter's lock from the event loop. The executor
starts `python -I -S journal_copy.py`, so this file imports the standard library only.

Both files begin with a page that names the process that uses the journal. Two slots of whole pages follow, each with a
record: CRC-32, number of the record, checksum of the actuators' labels, and more that the copier does not read. A copy
writes over the older record on the disk. After a power failure during the write the other record is whole.
"""

import contextlib
import fcntl
import mmap
import os
import select
import struct
import sys
import time
import zlib
from pathlib import Path
from typing import IO, NamedTuple

MAGIC = b"hyperbit switches 1\n"
PAGE = mmap.PAGESIZE
CRC = 4  # bytes of the checksum before each record
HEAD = struct.Struct("<QI")
READS = 10  # of the file in memory, until one is not disturbed by the executor's write
RETRY = 0.02  # [s] between two attempts to lock a file
LONGEST_LINE = 1_000  # bytes of a message; a pipe takes 4,096 at once


class JournalInUse(Exception):
    """Another process uses the file."""


class JournalRecord(NamedTuple):
    """An intact record.

    Attributes:
        number: of the record; the newest one has the greatest.
        labels: checksum of the actuators' labels.
        body: the record without its checksum.
    """

    number: int
    labels: int
    body: bytes


class JournalLayout(NamedTuple):
    """Places of the records in a file.

    Attributes:
        size: of a record without its checksum [bytes].
    """

    size: int

    @property
    def slot(self) -> int:
        """Size of a slot [bytes]."""
        return -(-(CRC + self.size) // PAGE) * PAGE

    @property
    def length(self) -> int:
        """Size of a file [bytes]."""
        return PAGE + 2 * self.slot

    def begin(self, number: int) -> int:
        """Returns the place of slot `number` (0 or 1)."""
        return PAGE + number * self.slot

    def records(self, content: bytes) -> list[JournalRecord | None]:
        """Returns the records of both slots, None for a slot without an intact record."""
        return [self._record(content[begin : begin + CRC + self.size]) for begin in map(self.begin, range(2))]

    def _record(self, content: bytes) -> JournalRecord | None:
        body = content[CRC:]
        if len(body) < self.size or content != packed(body):
            return None
        number, labels = HEAD.unpack_from(body)
        return JournalRecord(number, labels, body)


def packed(body: bytes) -> bytes:
    """Returns a record with its checksum."""
    return zlib.crc32(body).to_bytes(CRC, "little") + body


class DiskCopy:
    """The journal's file on the disk. Only the process that has locked the file writes it.

    Args:
        path: of the file.
        layout: places of the records.
        file: the file, if it is open and locked already; otherwise it is opened when it is needed.
    """

    def __init__(self, path: Path, layout: JournalLayout, file: IO[bytes] | None = None) -> None:
        self.file = file
        self._path, self._layout = path, layout
        self._copied = 0  # number of the record that this object has brought to the disk

    def read(self, timeout: float) -> bytes:
        """Returns the content of the file, b"" if it cannot be read. Waits up to `timeout` [s] for the lock.

        Raises:
            JournalInUse: another process uses it.
        """
        try:
            return os.pread(self._opened(timeout).fileno(), self._layout.length, 0)
        except OSError:
            with contextlib.suppress(OSError):  # a file that can be read only
                return self._path.read_bytes()[: self._layout.length]
        return b""

    def copy(self, content: bytes) -> None:
        """Brings the newest record of the file in memory, whose content is given, to the disk.

        Raises:
            JournalInUse: another process uses the file on the disk.
            OSError: the record cannot be written, or `content` has no intact record.
        """
        found = [record for record in self._layout.records(content) if record is not None]
        if not found:
            raise OSError("the file in memory has no intact record")
        newest = max(found)
        if newest.number == self._copied:
            return
        file = self._opened().fileno()
        kept = os.pread(file, self._layout.length, 0)
        ages = [  # a record of the same number may have failed to reach the disk, and is written again
            old.number if old and old.labels == newest.labels and old.number < newest.number else 0
            for old in self._layout.records(kept)
        ]
        self._write(self._layout.begin(ages.index(min(ages))), packed(newest.body))
        if kept[:PAGE] != content[:PAGE]:
            self._write(0, content[:PAGE])
        os.fdatasync(file)
        self._copied = newest.number

    def close(self) -> None:
        """Closes the file, which unlocks it."""
        if self.file is not None:
            self.file.close()

    def _opened(self, timeout: float = 0.0) -> IO[bytes]:
        if self.file is None:
            self.file = locked_file(self._path, timeout)
        if os.fstat(self.file.fileno()).st_size < self._layout.length:
            os.posix_fallocate(self.file.fileno(), 0, self._layout.length)  # later copies need no more space
            os.fsync(self.file.fileno())
            folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(folder)  # the name of a new file
            finally:
                os.close(folder)
        return self.file

    def _write(self, begin: int, octets: bytes) -> None:
        assert self.file is not None
        if os.pwrite(self.file.fileno(), octets, begin) < len(octets):
            raise OSError("the disk is full")


def locked_file(path: Path, timeout: float = 0.0, journal: Path | None = None) -> IO[bytes]:
    """Returns a file that no other process uses, unbuffered; created if it does not exist.

    Args:
        path: of the file.
        timeout: longest time to wait for the end of another process [s].
        journal: path that the message names; None: `path`.

    Raises:
        JournalInUse: another process uses it; the text names it.
        OSError: it cannot be opened.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600), "r+b", buffering=0)
    deadline = time.monotonic() + timeout
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            if time.monotonic() >= deadline:
                lines = file.read(PAGE).split(b"\n")
                file.close()
                pid = lines[1].decode(errors="replace") if len(lines) > 1 else "unknown"
                raise JournalInUse(f"the switch journal {journal or path} is in use by process {pid}") from None
        except OSError:
            file.close()
            raise
        time.sleep(RETRY)


def content_of(memory: int, layout: JournalLayout) -> bytes:
    """Returns the content of the file in memory with an intact record, unless there is none.

    Args:
        memory: file descriptor.
        layout: places of the records.
    """
    for _ in range(READS):
        content = os.pread(memory, layout.length, 0)
        if any(layout.records(content)):
            break
    return content


def run(disk: DiskCopy, layout: JournalLayout, memory: int, interval: float) -> None:
    """Copies the newest record at each interval, and a last time when the standard input ends.

    The standard output has a line for each change: why the last copy failed, or an empty line if it succeeded.

    Args:
        disk: the file on the disk.
        layout: places of the records.
        memory: descriptor of the file in memory.
        interval: between two copies [s].
    """
    told, ended = None, False
    while not ended:
        ended = bool(select.select([0], [], [], interval)[0])
        try:
            disk.copy(content_of(memory, layout))
            problem = b""
        except (OSError, JournalInUse) as error:
            problem = " ".join(str(error).split()).encode(errors="replace")[:LONGEST_LINE]
        if problem != told:
            with contextlib.suppress(OSError):  # the executor has been killed
                os.write(1, problem + b"\n")
        told = problem


def main(path: str, size: str, memory: str, disk: str, interval: str) -> None:
    """Runs the copier; `disk` is the descriptor of the locked file on the disk, or -1. See `run`."""
    with contextlib.suppress(OSError):  # of a real-time executor whose unit lets children inherit its priority
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    layout, file = JournalLayout(int(size)), None if int(disk) < 0 else os.fdopen(int(disk), "r+b", buffering=0)
    run(DiskCopy(Path(path), layout, file), layout, int(memory), float(interval))


if __name__ == "__main__":
    main(*sys.argv[1:])
