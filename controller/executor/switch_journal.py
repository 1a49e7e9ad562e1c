"""The switch journal: counts of switches that survive a killed process and a reboot.

A disk can keep a writer waiting for seconds, even if the file is mapped into memory. Therefore the executor writes to a
file in memory, which systemd keeps for a service, and which is in /dev/shm otherwise. This file outlives the process,
but not a reboot. So it is copied to the disk when the process begins and ends. After a power failure the counts
continue from the planner's ledger.

Each file has two records with checksums, which are written in turn. One of them is whole whenever the process ends.
"""

import contextlib
import fcntl
import hashlib
import logging
import mmap
import os
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Protocol

from controller.executor.bits import indices

log = logging.getLogger(__name__)

MAGIC = b"hyperbit switches 1\n"
PAGE = mmap.PAGESIZE
SHARED = Path("/dev/shm")  # a file system in memory


class JournalInUse(Exception):
    """Another process uses the file."""


class SwitchJournal(Protocol):
    """Counts the switches of A actuators.

    The intended states of a stage are recorded before its SYNC. A process that is killed after that cannot know whether
    the SYNC was sent; the boards' outputs tell the next process.

    Attributes:
        counts: number of switches of each actuator, shape (A,).
        problem: why counts were lost or will be lost, as a sentence; None if they are safe.
    """

    counts: list[int]
    problem: str | None

    def intend(self, before: int, after: int) -> None:
        """Records the intention to switch from the states `before` to the states `after`."""

    def resolve(self, states: int, unknown: int = 0) -> int:
        """Counts the intended switches that took place, as `states` show; returns the mask of these actuators.

        Args:
            states: present states of the outputs.
            unknown: mask of the actuators whose state is unknown; these are not counted.
        """

    def raise_to(self, counts: Sequence[int]) -> None:
        """Raises counts (A,) to those of the planner's ledger: counts only grow, so the greater one is right."""

    def close(self) -> None:
        """Closes the file."""


class MemoryJournal:
    """A journal in memory, lost with the process. See `SwitchJournal`."""

    def __init__(self, actuators: int) -> None:
        """Takes the number of actuators."""
        self.counts = [0] * actuators
        self.problem: str | None = None
        self._intended = self._after = 0

    def intend(self, before: int, after: int) -> None:
        """See `SwitchJournal`."""
        self._intended, self._after = before ^ after, after
        self._write()

    def resolve(self, states: int, unknown: int = 0) -> int:
        """See `SwitchJournal`."""
        if not self._intended:
            return 0
        switched = self._intended & ~(self._after ^ states) & ~unknown
        for k in indices(switched):
            self.counts[k] += 1
        self._intended = 0
        self._write()
        return switched

    def raise_to(self, counts: Sequence[int]) -> None:
        """See `SwitchJournal`."""
        if len(counts) == len(self.counts) and any(a > b for a, b in zip(counts, self.counts, strict=True)):
            self.counts = [max(pair) for pair in zip(counts, self.counts, strict=True)]
            self._write()

    def close(self) -> None:
        """Does nothing."""

    def _write(self) -> None:
        """Does nothing."""


class FileJournal(MemoryJournal):
    """A journal in two files, see above. See `SwitchJournal`.

    The first page of a file has the number of the process that uses it. The two records follow on further pages.

    Args:
        path: of the file on the disk. Only the constructor and `close` write it. A disk that is full or read-only is a
            problem, but no error: the counts are kept in memory, and `close` tries again.
        actuators: labels (A,); counts of other actuators are not read.
        memory: file in memory, empty or of an earlier process; None: one in /dev/shm, which `close` removes.

    Raises:
        JournalInUse: another process uses the journal; the text names it.
        OSError: the file in memory cannot be written.
    """

    def __init__(self, path: Path, actuators: Sequence[str], memory: IO[bytes] | None = None) -> None:
        super().__init__(len(actuators))
        self._labels, self._number = zlib.crc32("\n".join(actuators).encode()), 0
        octets = (len(actuators) + 7) // 8
        self._record = struct.Struct(f"<QI{len(actuators)}Q{octets}s{octets}s")
        self._octets = octets
        self._part = -(-(4 + self._record.size) // PAGE) * PAGE
        self._path, size = path, PAGE + 2 * self._part
        self._shared = shared_path(path) if memory is None else None
        self._disk: IO[bytes] | None = None
        with contextlib.ExitStack() as closing:
            self._closing = closing
            kept = self._open_disk(size)
            memory = closing.enter_context(memory or locked_file(shared_path(path)))
            os.posix_fallocate(memory.fileno(), 0, size)  # no SIGBUS when the memory is full
            self._map = mmap.mmap(memory.fileno(), size)
            found = self._read(kept), self._read(self._map[:])
            if kept and not any(found):
                self.problem = f"{path} is damaged or of other actuators: counts of switches continue from the ledger's"
                log.warning("%s", self.problem)
            self._map[:PAGE] = (MAGIC + b"%d\n" % os.getpid()).ljust(PAGE, b"\0")
            self._write()
            self._try_to_save()
            self._closing = closing.pop_all()

    def close(self) -> None:
        """Copies the records to the disk and closes the files."""
        if self._map.closed:
            return
        if self._try_to_save() and self._shared is not None:
            self._shared.unlink(missing_ok=True)
        self._map.close()
        self._closing.close()

    def _open_disk(self, size: int) -> bytes:
        """Opens and locks the file on the disk, if that is possible; returns up to `size` bytes of its content.

        Raises:
            JournalInUse: another process uses it.
        """
        try:
            self._disk = self._closing.enter_context(locked_file(self._path))
            return self._disk.read(size)
        except OSError:
            with contextlib.suppress(OSError):  # a file that can be read only
                return self._path.read_bytes()[:size]
        return b""

    def _try_to_save(self) -> bool:
        """Copies the file in memory to the disk; returns whether that succeeded. A failure becomes the problem."""
        try:
            if self._disk is None:
                self._disk = self._closing.enter_context(locked_file(self._path))
            self._disk.seek(0)
            if self._disk.write(self._map[:]) < len(self._map):
                raise OSError("the disk is full")
            os.fsync(self._disk.fileno())
        except (OSError, JournalInUse) as error:
            lost = "" if self.problem is None else f"; {self.problem}"
            self.problem = (
                f"counts of switches cannot be written to {self._path}: {error}; they are kept in memory, and a power"
                f" failure loses them: free disk space, or make the folder writable{lost}"
            )
            log.error("%s", self.problem)
            return False
        return True

    def _write(self) -> None:
        """Writes a record over the older of the two."""
        if self._map.closed:
            return
        self._number += 1
        intended, after = (bits.to_bytes(self._octets, "little") for bits in (self._intended, self._after))
        body = self._record.pack(self._number, self._labels, *self.counts, intended, after)
        begin = PAGE + self._number % 2 * self._part
        self._map[begin : begin + 4 + len(body)] = zlib.crc32(body).to_bytes(4, "little") + body

    def _read(self, content: bytes) -> bool:
        """Takes the newest intact record if it is newer; returns whether there is a record of these actuators."""
        found = False
        for begin in (PAGE, PAGE + self._part):
            body = content[begin + 4 : begin + 4 + self._record.size]
            if len(body) < self._record.size or int.from_bytes(content[begin : begin + 4], "little") != zlib.crc32(
                body
            ):
                continue
            number, labels, *counts, intended, after = self._record.unpack(body)
            found |= labels == self._labels
            if labels == self._labels and number > self._number:
                self._number, self.counts = number, list(counts)
                self._intended, self._after = (int.from_bytes(bits, "little") for bits in (intended, after))
        return found


def shared_path(path: Path) -> Path:
    """Returns the path in /dev/shm of the file in memory of a journal on the disk."""
    name = hashlib.blake2b(os.fsencode(path.absolute()), digest_size=8).hexdigest()
    return SHARED / f"hyperbit-{os.getuid()}-{name}.switches"


def locked_file(path: Path) -> IO[bytes]:
    """Returns a file that no other process uses, unbuffered; created if it does not exist.

    Raises:
        JournalInUse: another process uses it; the text names it.
        OSError: it cannot be opened.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    file = os.fdopen(number, "r+b", buffering=0)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lines = file.read(PAGE).split(b"\n")
        pid = lines[1].decode(errors="replace") if len(lines) > 1 else "unknown"
        file.close()
        raise JournalInUse(f"the switch journal {path} is in use by process {pid}") from None
    return file


def default_path(arm: str) -> Path:
    """Returns the path of an arm's journal: in systemd's StateDirectory, else in XDG_STATE_HOME."""
    folder = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    return (Path(folder) if folder else Path(base) / "hyperbit") / f"{arm}.switches"
