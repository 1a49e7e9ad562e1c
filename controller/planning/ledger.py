"""The ledger: switches of each actuator, goals and their results, in one SQLite file.

The executor's switch journal counts each switch exactly once. The ledger keeps a second copy of the counts. The greater
of two counts is valid, so losing one of the files loses no counts.
"""

import fcntl
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from controller.planning.ledger_file import MOST_GOALS, Entry, LedgerFile, counted, damaged
from controller.program import Fault

log = logging.getLogger(__name__)

WRITE_EVERY = 5.0  # [s] between two transactions, because each one wears flash memory


class Ledger:
    """Collects counts and results in memory and writes them in batches. For any thread.

    A thread with one connection writes at most every WRITE_EVERY seconds. The end of a goal is written as soon as that
    allows. If the file cannot be written, `fault` says why, and the data is written later. A damaged file is renamed;
    a new file begins with the present counts.

    Attributes:
        path: of the file.
        fault: why the file cannot be written now; None if it can.
        damage: what happened to a damaged file; None if no file was damaged.

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
        self._goals: deque[Entry] = deque(maxlen=2 * MOST_GOALS)
        self._news = threading.Condition()
        self._due, self._closing = 0.0, False
        self._thread = threading.Thread(target=self._run, name="ledger", daemon=True)
        self._thread.start()

    def accepted(self, number: int, goal: str, waypoints: int) -> None:
        """Records an accepted goal.

        Args:
            number: of its program; `ended` refers to the goal by this number.
            goal: its id.
            waypoints: number of waypoints.
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
        """Records the result of the latest goal of a program number.

        Args:
            number: of the program.
            status: of the result.
            code: of the result.
            message: of the result.
            switches: of all actuators.
            accepted: id, time [UNIX s] and waypoints of a goal of an earlier planner process. If that was killed
                    before it wrote the goal, the goal is recorded now.
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
        """Returns the number of switches of each actuator so far."""
        return self._counts

    def faults(self) -> tuple[Fault, ...]:
        """Returns the faults of the file; they do not stop the arm."""
        problems = (("ledger-unwritten", self.fault), ("ledger-damaged", self.damage))
        return tuple(Fault(code, "ledger", message) for code, message in problems if message is not None)

    def close(self, timeout: float = 5.0) -> None:
        """Writes the rest, and frees the ledger for other processes."""
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
        """Makes the thread write within a time [s], or as soon as WRITE_EVERY allows."""
        self._due = min(self._due, time.monotonic() + within)
        self._news.notify()

    def _run(self) -> None:
        earliest, closing = 0.0, False  # the first transaction opens the file, and detects damage
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
        """Writes the collected data; returns whether that succeeded."""
        for _ in range(2):  # the second time into a new file, if the old one is damaged
            try:
                self._file.write(goals, counts)
                self.fault = None
                return True
            except Exception as error:
                self._file.close()
                if damaged(error) and (renamed := self._file.set_aside()) is not None:
                    what = f"was damaged ({error}) and renamed to {renamed}; a new one was begun"
                    self.damage = f"ledger {self.path} {what}"
                    log.error("%s", self.damage)
                    continue
                if self.fault is None:
                    log.error("ledger %s cannot be written, counting continues in memory: %s", self.path, error)
                self.fault = f"ledger {self.path} cannot be written: {error}"
                break
        return False


def plain(text: str) -> str:
    """Returns a text that SQLite can store: lone surrogates become escapes."""
    return text.encode(errors="backslashreplace").decode()


class LedgerInUse(Exception):
    """Another process has the ledger; the text says which."""


class LedgerLock:
    """A file lock on "<ledger>.lock"; the kernel releases it when the process ends.

    The ledger itself cannot carry the lock: closing another file descriptor of it would drop SQLite's own locks.
    Without write access to the folder there is no lock, and the ledger reports that it cannot be written.

    Raises:
        LedgerInUse: another process has the lock.
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
        """Releases the lock."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
