"""The ledger: switches of every actuator, goals and their results, in one SQLite file.

The counts are the executor's: its switch journal counts each switch exactly once. The ledger keeps a second copy, so
that neither file alone can lose them; the greater of the two counts holds.
"""

import fcntl
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from controller.planning.ledger_file import KEPT, Entry, LedgerFile, counted, damaged
from controller.program import Fault

log = logging.getLogger(__name__)

WRITE_EVERY = 5.0  # [s] between two transactions: flash memory wears with each


class Ledger:
    """Collects counts and results in memory and writes them in batches. All methods may be called from any thread.

    A thread with one open connection writes at most every WRITE_EVERY seconds, and the end of a goal as soon as that
    allows. If the file cannot be written, `fault` says why, and what was collected is written later. A damaged file is
    moved aside, and a new one begins with the counts.

    Attributes:
        path: of the file.
        fault: why the file cannot be written now; None while it can.
        damage: what became of a damaged file; None if no file was damaged.

    Args:
        path: of the file; it and its folder are made if they are missing.
        actuators: labels, in the order of the state vectors.
        write_every: shortest time between two transactions [s].

    Raises:
        LedgerInUse: another process writes this ledger.
    """

    def __init__(self, path: Path, actuators: Sequence[str], write_every: float = WRITE_EVERY) -> None:
        self.path = path
        self.fault: str | None = None
        self.damage: str | None = None
        self._lock_file = LedgerLock(path)
        known = counted(path)
        self._actuators, self._write_every = tuple(actuators), write_every
        self._counts = tuple(known.get(label, 0) for label in actuators)
        self._file = LedgerFile(path, self._actuators)
        self._goals: deque[Entry] = deque(maxlen=2 * KEPT)
        self._news = threading.Condition()
        self._due, self._closing = 0.0, False
        self._thread = threading.Thread(target=self._run, name="ledger", daemon=True)
        self._thread.start()

    def accepted(self, number: int, goal: str, waypoints: int) -> None:
        """Enters an accepted goal.

        Args:
            number: of its program; `ended` names it by this number.
            goal: its id.
            waypoints: how many it has.
        """
        self._enter(Entry(number, accepted=(plain(goal), time.time(), waypoints)), self._write_every)

    def ended(
        self,
        number: int,
        status: str,
        code: int,
        message: str,
        switches: int,
        accepted: tuple[str, float, int] | None = None,
    ) -> None:
        """Enters the result of the latest goal of a program number.

        Args:
            number: of the program.
            status: of the result.
            code: of the result.
            message: of the result.
            switches: of all actuators.
            accepted: id, time [UNIX s] and waypoints of a goal that another run of the planner has accepted. That run
                may have been killed before it wrote the goal; then the goal is entered now.
        """
        before = None if accepted is None else (plain(accepted[0]), *accepted[1:])
        self._enter(Entry(number, before, (time.time(), status, code, plain(message), switches)), 0.0)

    def counts(self, counts: Sequence[int]) -> None:
        """Takes the executor's counts, one for each actuator; a count never falls."""
        if len(counts) != len(self._actuators):
            log.error("the executor counts %d actuators, the ledger %d", len(counts), len(self._actuators))
            return
        with self._news:
            if (highest := tuple(map(max, self._counts, counts))) != self._counts:
                self._counts = highest
                self._set_due(self._write_every)

    def known(self) -> tuple[int, ...]:
        """Returns the switches of each actuator so far."""
        return self._counts

    def faults(self) -> tuple[Fault, ...]:
        """Returns what is wrong with the file; the arm moves all the same."""
        told = (("ledger-unwritten", self.fault), ("ledger-damaged", self.damage))
        return tuple(Fault(code, "ledger", message) for code, message in told if message is not None)

    def close(self, timeout: float = 5.0) -> None:
        """Writes what is left, and lets another process have the ledger."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(timeout)
        self._lock_file.close()

    def _enter(self, entry: Entry, within: float) -> None:
        with self._news:
            self._goals.append(entry)
            self._set_due(within)

    def _set_due(self, within: float) -> None:
        """Has the thread write within so many seconds, or as soon as it may."""
        self._due = min(self._due, time.monotonic() + within)
        self._news.notify()

    def _run(self) -> None:
        earliest, closing = 0.0, False  # the first transaction opens the file, and finds whether it is damaged
        while not closing:
            with self._news:
                while not self._closing and (wait := max(self._due, earliest) - time.monotonic()) > 0:
                    self._news.wait(min(wait, threading.TIMEOUT_MAX))
                closing, self._due = self._closing, float("inf")
                goals, counts = tuple(self._goals), self._counts
            written = self._write(goals, counts)
            with self._news:
                if written:
                    for _ in range(min(len(goals), len(self._goals))):
                        self._goals.popleft()
                else:
                    self._set_due(self._write_every)
            earliest = time.monotonic() + self._write_every
        self._file.close()

    def _write(self, goals: Sequence[Entry], counts: Sequence[int]) -> bool:
        """Writes what was collected; returns whether that is done."""
        for _ in range(2):  # the second time to a new file
            try:
                self._file.write(goals, counts)
                self.fault = None
                return True
            except Exception as error:
                self._file.close()
                if damaged(error) and (aside := self._file.set_aside()) is not None:
                    self.damage = (
                        f"ledger {self.path} was damaged ({error}): it is {aside} now, and a new one was begun"
                    )
                    log.error("%s", self.damage)
                    continue
                if self.fault is None:
                    log.error("ledger %s cannot be written, counting goes on in memory: %s", self.path, error)
                self.fault = f"ledger {self.path} cannot be written: {error}"
                break
        return False


def plain(text: str) -> str:
    """Returns a text that SQLite can store: half surrogate pairs are written out."""
    return text.encode(errors="backslashreplace").decode()


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
