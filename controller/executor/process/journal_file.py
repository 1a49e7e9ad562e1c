"""The switch journal's files: counts of switches survive a killed process, a reboot and a power failure.

A disk can keep a writer waiting for seconds, even if the file is mapped into memory. Therefore the executor writes to a
file in memory, which systemd keeps for a service, and which is in /dev/shm otherwise. This file outlives the process,
but not a reboot. So a keeper copies it whole to the disk once a minute, and once more when the executor has ended in
any way. The executor itself writes the disk only at its start, and at its end when the keeper has ended.
"""

import contextlib
import hashlib
import logging
import mmap
import os
import struct
import subprocess
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.host.files import read_file, set_aside
from hyperbit.controller.host.folders import state_folder
from hyperbit.controller.host.keeper import GONE, SHARED, lock_file, start_keeper, write_whole

log = logging.getLogger(__name__)

INTERVAL = 60.0  # [s] between two copies; a power failure loses the counts since the last one
LAST_COPY = 2.0  # [s] for the last copy after an earlier executor
ENDING = 1.0  # [s] for the last copy
PAGE = mmap.PAGESIZE
CRC = 4  # bytes of the checksum before each record


class FileJournal(SwitchJournal):
    """A journal in a file in memory and its copy on the disk.

    The file begins with a page that names the process. Two slots of whole pages follow. Each write replaces the older
    of their records, so a process killed meanwhile leaves the other record. A record has a checksum, its number, a
    checksum of the actuators' labels, the counts, and the intended switches.

    A full or read-only disk is a problem, but no error: counts are kept in memory, and each copy tries again.

    Args:
        path: of the file on the disk.
        actuators: labels (A,); counts of other actuators are not read.
        memory: file in memory, empty or of an earlier process; None: one in /dev/shm, which `close` removes. FileInUse
            is raised if another process uses it.
        last_copy: longest time to wait for the last copy of an earlier executor [s].
    """

    def __init__(
        self,
        path: Path,
        actuators: Sequence[str],
        memory: IO[bytes] | None = None,
        last_copy: float = LAST_COPY,
    ) -> None:
        super().__init__(len(actuators))
        self._path, self._labels, self.number = path, zlib.crc32("\n".join(actuators).encode()), 0
        self._octets = (len(actuators) + 7) // 8
        self._record = struct.Struct(f"<QI{len(actuators)}Q{self._octets}s{self._octets}s")
        slot = -(-(CRC + self._record.size) // PAGE) * PAGE
        self.slots, length = (PAGE, PAGE + slot), PAGE + 2 * slot
        self.copier: subprocess.Popen[bytes] | None = None
        self._damaged = self._unsaved = ""
        self._shared = None
        if memory is None:
            self._shared = shared_path(path)
            number = lock_file(self._shared, f"the switch journal {path} is in use by process", last_copy)
            memory = os.fdopen(number, "r+b", buffering=0)
        self.memory = memory
        os.posix_fallocate(memory.fileno(), 0, length)  # no SIGBUS when the memory is full
        self.mapped = mmap.mmap(memory.fileno(), length)
        kept, why = b"", None
        try:
            kept, why = read_file(path), "it is no journal, or of other actuators"
        except (FileNotFoundError, NotADirectoryError):
            pass
        except OSError as error:
            why = error.strerror
        why = None if self._read(kept) else why
        current = self._read(self.mapped[:])
        if why:
            then = "the file in memory has the counts" if current else "counts of switches continue from the ledger's"
            told = set_aside(path, why, then)
            self._damaged = "" if current else told or f"{path} is damaged ({why}): {then}"
        self._write()
        self.save()

    @property
    def problem(self) -> str | None:
        """See `SwitchJournal`. Never waits."""
        if self.copier is not None and self.copier.stdout is not None and not self.copier.stdout.closed:
            with contextlib.suppress(BlockingIOError):
                told = os.read(self.copier.stdout.fileno(), 1 << 16).splitlines()
                for line in told or [b"the process that copies them has ended"]:
                    if line == GONE:
                        log.warning("%s %s", self._path, GONE.decode())
                    else:
                        self._note(line.decode(errors="replace"))
                if not told:
                    self.copier.stdout.close()
        return "; ".join(text for text in (self._unsaved, self._damaged) if text) or None

    def start_copier(self, interval: float = INTERVAL) -> None:
        """Starts the keeper that copies the counts to the disk. Call before the real time begins.

        The keeper shares the lock on the file in memory: another executor begins after the last copy. Without a keeper
        `close` copies the counts.
        """
        memory = self.memory.fileno()
        try:
            self.copier = start_keeper("copy", memory, self._path.absolute(), interval, files=[memory])
        except OSError as error:
            self._note(f"the process that copies them cannot be started: {error}")

    def close(self) -> None:
        """Copies the counts to the disk and closes the files. Does not write beside a keeper that hangs."""
        if self.mapped.closed:
            return
        if (copier := self.copier) is not None:
            for pipe in filter(None, (copier.stdin, copier.stdout)):
                pipe.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                copier.wait(ENDING)
        if copier is not None and copier.returncode is None:
            self._note(f"the disk is slow; process {copier.pid} still copies them")
        elif self.save() and self._shared is not None:
            self._shared.unlink(missing_ok=True)
        self.mapped.close()
        self.memory.close()

    def save(self) -> bool:
        """Copies the counts to the disk; returns whether that succeeded. A failure becomes the problem."""
        error = ""
        try:
            write_whole(self._path, self.mapped[:])
        except OSError as failure:
            error = str(failure)
        self._note(error)
        return not error

    def _note(self, error: str) -> None:
        """Stores and logs why the last copy to the disk failed, "" if it succeeded."""
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
        if self.mapped.closed:
            return
        self.number += 1
        intended, after = (bits.to_bytes(self._octets, "little") for bits in (self._intended, self._after))
        body = self._record.pack(self.number, self._labels, *self.counts, intended, after)
        begin = self.slots[self.number % 2]
        self.mapped[begin : begin + CRC + len(body)] = zlib.crc32(body).to_bytes(CRC, "little") + body

    def _read(self, content: bytes) -> bool:
        """Reads the newest intact record if it is newer; returns whether a record of these actuators exists."""
        found = False
        for begin in self.slots:
            body = content[begin + CRC : begin + CRC + self._record.size]
            intact = zlib.crc32(body).to_bytes(CRC, "little") == content[begin : begin + CRC]
            if len(body) < self._record.size or not intact:
                continue
            number, labels, *counts, intended, after = self._record.unpack(body)
            found |= labels == self._labels
            if labels == self._labels and number > self.number:
                self.number, self.counts = number, list(counts)
                self._intended, self._after = (int.from_bytes(bits, "little") for bits in (intended, after))
        return found


def shared_path(path: Path) -> Path:
    """Returns the path in /dev/shm of the file in memory of a journal on the disk."""
    name = hashlib.blake2b(os.fsencode(path.absolute()), digest_size=8).hexdigest()
    return SHARED / f"hyperbit-{os.getuid()}-{name}.switches"


def default_path(arm: str, *, simulated: bool = False) -> Path:
    return state_folder(simulated=simulated) / f"{arm}.switches"
