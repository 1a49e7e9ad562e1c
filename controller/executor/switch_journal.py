"""The switch journal: counts of switches that survive a killed process and a reboot.

The file has two records with checksums, which are written in turn. One of them is whole whenever the process ends. The
file is mapped into memory: a write never waits for the disk, and the kernel writes the pages out.
"""

import fcntl
import logging
import mmap
import os
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from controller.executor.bits import indices

log = logging.getLogger(__name__)

MAGIC = b"hyperbit switches 1\n"
PAGE = mmap.PAGESIZE


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
    """A journal in a file. See `SwitchJournal`.

    The first page of the file has the number of the process that uses it. The two records follow on further pages.

    Args:
        path: of the file; created if it does not exist.
        actuators: labels (A,); counts of other actuators are not read.

    Raises:
        JournalInUse: another process uses the file; the text names it.
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, actuators: Sequence[str]) -> None:
        super().__init__(len(actuators))
        self._labels, self._number = zlib.crc32("\n".join(actuators).encode()), 0
        octets = (len(actuators) + 7) // 8
        self._record = struct.Struct(f"<QI{len(actuators)}Q{octets}s{octets}s")
        self._octets = octets
        self._part = -(-(4 + self._record.size) // PAGE) * PAGE
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            self._lock(path)
            fresh = os.fstat(self._file).st_size == 0
            os.posix_fallocate(self._file, 0, PAGE + 2 * self._part)  # no SIGBUS on a full disk
            self._map = mmap.mmap(self._file, PAGE + 2 * self._part)
        except BaseException:
            os.close(self._file)
            raise
        self._map[:PAGE] = (MAGIC + b"%d\n" % os.getpid()).ljust(PAGE, b"\0")
        if not self._read() and not fresh:
            self.problem = f"{path} is damaged or of other actuators: counts of switches continue from the ledger's"
            log.warning("%s", self.problem)
        self._write()

    def close(self) -> None:
        """Writes the file to the disk and closes it."""
        if not self._map.closed:
            self._map.flush()
            self._map.close()
            os.close(self._file)

    def _lock(self, path: Path) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lines = os.pread(self._file, PAGE, 0).split(b"\n")
            pid = lines[1].decode(errors="replace") if len(lines) > 1 else "unknown"
            raise JournalInUse(f"the switch journal {path} is in use by process {pid}") from None

    def _write(self) -> None:
        """Writes a record over the older of the two."""
        if self._map.closed:
            return
        self._number += 1
        intended, after = (bits.to_bytes(self._octets, "little") for bits in (self._intended, self._after))
        body = self._record.pack(self._number, self._labels, *self.counts, intended, after)
        begin = PAGE + self._number % 2 * self._part
        self._map[begin : begin + 4 + len(body)] = zlib.crc32(body).to_bytes(4, "little") + body

    def _read(self) -> bool:
        """Reads the newer intact record; returns whether there is one of these actuators."""
        for begin in (PAGE, PAGE + self._part):
            body = self._map[begin + 4 : begin + 4 + self._record.size]
            if int.from_bytes(self._map[begin : begin + 4], "little") != zlib.crc32(body):
                continue
            number, labels, *counts, intended, after = self._record.unpack(body)
            if labels == self._labels and number > self._number:
                self._number, self.counts = number, list(counts)
                self._intended, self._after = (int.from_bytes(bits, "little") for bits in (intended, after))
        return self._number > 0


def default_path(arm: str) -> Path:
    """Returns the path of an arm's journal: in systemd's StateDirectory, else in XDG_STATE_HOME."""
    folder = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    return (Path(folder) if folder else Path(base) / "hyperbit") / f"{arm}.switches"
