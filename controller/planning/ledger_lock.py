"""The lock beside a ledger: one process writes it at a time."""

import fcntl
import logging
import os
from pathlib import Path

log = logging.getLogger(__name__)


class LedgerInUse(Exception):
    """Another process has the ledger; the text says which."""


class LedgerLock:
    """A file lock on "<ledger>.lock", which the kernel frees when the process ends.

    The ledger itself cannot carry the lock: closing a second file descriptor of it would drop SQLite's own locks.
    If the folder cannot be written, there is no lock: the ledger then says that it cannot be written.

    Raises:
        LedgerInUse: another process has it.
    """

    def __init__(self, ledger: Path) -> None:
        self._file: int | None = None
        path = ledger.with_name(f"{ledger.name}.lock")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            log.warning("%s: no lock on the ledger: %s", path, error.strerror)
            return
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.pread(file, 100, 0).decode(errors="replace").strip() or "unknown"
            os.close(file)
            raise LedgerInUse(
                f"the ledger {ledger} is in use by another daemon, process {owner}: end it first"
            ) from None
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        self._file = file

    def close(self) -> None:
        """Frees the lock."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
