"""The switch journal: counts of switches that survive a killed process, a reboot and a power failure.

A disk can keep a writer waiting for seconds, even if the file is mapped into memory. Therefore the executor writes to a
file in memory, which systemd keeps for a service, and which is in /dev/shm otherwise. This file outlives the process,
but not a reboot. So a second process, the copier, copies it to the disk every 10 s, and once more when the executor has
ended in any way. The executor itself writes the disk only at its start, and at its end when the copier has ended.
"""

import contextlib
import hashlib
import logging
import mmap
import os
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Protocol

from hyperbit.controller.executor.arm.bits import indices
from hyperbit.controller.executor.journal.copier import Copier
from hyperbit.controller.executor.journal.journal_copy import (
    MAGIC,
    PAGE,
    DiskCopy,
    JournalInUse,
    JournalLayout,
    locked_file,
    packed,
)
from hyperbit.controller.host.folders import state_folder

log = logging.getLogger(__name__)

SHARED = Path("/dev/shm")  # a file system in memory
INTERVAL = 10.0  # [s] between two copies, which a power failure loses
LAST_COPY = 2.0  # [s] for the last copy after an earlier executor


class SwitchJournal(Protocol):
    """Counts the switches of A actuators.

    The intended states of a stage are recorded before its SYNC. A process that is killed after that cannot know whether
    the SYNC was sent; the boards' outputs tell the next process.

    Attributes:
        counts: number of switches of each actuator, shape (A,).
    """

    counts: list[int]

    @property
    def problem(self) -> str | None:
        """Why counts were lost or will be lost, as a sentence; None if they are safe."""

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
        self._intended = self._after = 0

    @property
    def problem(self) -> str | None:
        """See `SwitchJournal`."""
        return None

    def __reduce__(self) -> tuple[object, ...]:
        """Pickles any journal as one in memory: files belong to the process."""
        state = {"counts": self.counts, "_intended": self._intended, "_after": self._after}
        return MemoryJournal, (len(self.counts),), state

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

    Args:
        path: of the file on the disk. Only the constructor, the copier and `close` write it. A disk that is full or
            read-only is a problem, but no error: the counts are kept in memory, and each copy tries again.
        actuators: labels (A,); counts of other actuators are not read.
        memory: file in memory, empty or of an earlier process; None: one in /dev/shm, which `close` removes.

    Raises:
        JournalInUse: another process uses the journal; the text names it.
        OSError: the file in memory cannot be written.
    """

    def __init__(self, path: Path, actuators: Sequence[str], memory: IO[bytes] | None = None) -> None:
        super().__init__(len(actuators))
        self._labels, self._number = zlib.crc32("\n".join(actuators).encode()), 0
        self._octets = (len(actuators) + 7) // 8
        self._record = struct.Struct(f"<QI{len(actuators)}Q{self._octets}s{self._octets}s")
        self._path, self._layout = path, JournalLayout(self._record.size)
        self._shared = shared_path(path) if memory is None else None
        self._disk = DiskCopy(path, self._layout)
        self._copier: Copier | None = None
        self._damaged = self._unsaved = ""
        with contextlib.ExitStack() as closing:
            self._memory = closing.enter_context(memory or locked_file(shared_path(path), journal=path))
            closing.callback(self._disk.close)
            kept = self._disk.read(LAST_COPY)
            os.posix_fallocate(self._memory.fileno(), 0, self._layout.length)  # no SIGBUS when the memory is full
            self._map = mmap.mmap(self._memory.fileno(), self._layout.length)
            found = self._read(kept), self._read(self._map[:])
            if any(kept) and not any(found):  # a new file has zeros
                self._damaged = (
                    f"{path} is damaged or of other actuators: counts of switches continue from the ledger's"
                )
                log.warning("%s", self._damaged)
            self._map[:PAGE] = (MAGIC + b"%d\n" % os.getpid()).ljust(PAGE, b"\0")
            self._write()
            self._try_to_save()
            self._closing = closing.pop_all()

    @property
    def problem(self) -> str | None:
        """See `SwitchJournal`."""
        news = self._copier.news() if self._copier is not None else None
        if news is not None:
            self._note(news)
        return "; ".join(text for text in (self._unsaved, self._damaged) if text) or None

    def start_copier(self, interval: float = INTERVAL) -> None:
        """Starts the process that copies the counts to the disk. Call before the real time begins.

        Without the process the counts are copied by `close`.

        Args:
            interval: between two copies [s].
        """
        try:
            self._copier = Copier(self._path, self._layout, self._memory.fileno(), self._disk, interval)
        except OSError as error:
            self._note(f"the process that copies them cannot be started: {error}")

    def close(self) -> None:
        """Copies the newest record to the disk and closes the files. Does not write beside a copier that hangs."""
        if self._map.closed:
            return
        if self._copier is not None and not self._copier.end():
            self._note(f"the disk is slow; process {self._copier.pid} still copies them")
        elif self._try_to_save() and self._shared is not None:
            self._shared.unlink(missing_ok=True)
        self._map.close()
        self._closing.close()

    def _try_to_save(self) -> bool:
        """Copies the newest record to the disk; returns whether that succeeded. A failure becomes the problem."""
        try:
            self._disk.copy(self._map[:])
        except (OSError, JournalInUse) as error:
            self._note(str(error))
            return False
        self._note("")
        return True

    def _note(self, error: str) -> None:
        """Notes why the last copy to the disk failed, "" if it succeeded; a change is logged."""
        text = error and (
            f"counts of switches cannot be written to {self._path}: {error}; they are kept in memory, and a power"
            " failure loses them: free disk space, make the folder writable, or restart the executor"
        )
        if text and text != self._unsaved:
            log.error("%s", text)
        elif self._unsaved and not text:
            log.info("counts of switches are written to %s again", self._path)
        self._unsaved = text

    def _write(self) -> None:
        """Writes a record over the older of the two in memory."""
        if self._map.closed:
            return
        self._number += 1
        intended, after = (bits.to_bytes(self._octets, "little") for bits in (self._intended, self._after))
        record = packed(self._record.pack(self._number, self._labels, *self.counts, intended, after))
        begin = self._layout.begin(self._number % 2)
        self._map[begin : begin + len(record)] = record

    def _read(self, content: bytes) -> bool:
        """Takes the newest intact record if it is newer; returns whether there is a record of these actuators."""
        found = [record for record in self._layout.records(content) if record and record.labels == self._labels]
        if found and max(found).number > self._number:
            self._number, _, *counts, intended, after = self._record.unpack(max(found).body)
            self.counts = list(counts)
            self._intended, self._after = (int.from_bytes(bits, "little") for bits in (intended, after))
        return bool(found)


def shared_path(path: Path) -> Path:
    """Returns the path in /dev/shm of the file in memory of a journal on the disk."""
    name = hashlib.blake2b(os.fsencode(path.absolute()), digest_size=8).hexdigest()
    return SHARED / f"hyperbit-{os.getuid()}-{name}.switches"


def default_path(arm: str, *, simulated: bool = False) -> Path:
    """Returns the path of an arm's journal, in `state_folder`."""
    return state_folder(simulated=simulated) / f"{arm}.switches"
