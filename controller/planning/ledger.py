"""The ledger: switches of each actuator, goals and their results, in one SQLite file; and marks of published results.

The executor's switch journal counts each switch exactly once. The ledger keeps a second copy of the counts. The greater
of two counts is valid, so losing one of the files loses no counts.

A written transaction is in the kernel's memory, so it survives the death of the process. SQLite in WAL mode with
synchronous=NORMAL calls fsync about every 4 MB only; the kernel itself writes to the disk within about 30 s. An fsync
for each goal would wear flash memory, and each result would wait for the disk. A power failure therefore loses the
goals of the last seconds, but does not damage the file. The switch journal has the counts up to the last 60 s.
"""

import errno
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import NamedTuple

import msgspec

from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.host.files import read_file
from hyperbit.controller.host.keeper import lock_file
from hyperbit.controller.messages.goals import Result
from hyperbit.controller.planning.core.events import Identity, Record, ResultEntry
from hyperbit.controller.planning.ledger_file import MOST_GOALS, LedgerFile, counted, damaged, owed, plain
from hyperbit.controller.program import Fault

log = logging.getLogger(__name__)

WRITE_EVERY = 5.0  # [s] between two transactions with counts alone: each one wears flash memory
LOOK_EVERY = 1.0  # [s] between two looks whether the file is still there
MOST_MARKS = 1_000  # the executor stores no more results


class Ledger:
    """Records goals, results and counts. No method waits, except `close`.

    A thread with one connection writes all waiting records at once, in one transaction. Counts are written with them,
    or alone after `write_every`. If the file cannot be written, `fault` says why, and the data is written later. A
    damaged file is set aside. A new file begins with the present counts, and with the goals that have no result yet.
    A file that was deleted or moved is begun anew within a second.

    In the ledger's thread, `recorded` takes the number of each record after it was written or failed, and `fatal` takes
    a message when the thread dies. Unless `threaded`, there is no thread: who owns the ledger calls `write_waiting`.

    Raises:
        FileInUse: another process writes this ledger.
    """

    def __init__(
        self,
        path: Path,  # it and its folder are made if they are missing
        actuators: Sequence[str],  # labels, in the order of the state vectors
        recorded: Callable[[int], None] = lambda _: None,
        fatal: Callable[[str], None] = lambda _: None,
        write_every: float = WRITE_EVERY,  # [s] between two transactions without a record
        clock: Callable[[], float] = time.monotonic,
        *,
        threaded: bool = True,
    ) -> None:
        self._path, self._lock = path, locked(path)
        self.fault: str | None = None  # why the file cannot be written now
        self.damage: str | None = None  # what happened to a damaged file
        counts = counted(path)
        self.known = tuple(counts.get(label, 0) for label in actuators)  # number of switches of each actuator so far
        self.owed = owed(path)  # goals that had no result when the ledger was opened
        self._recorded, self._fatal, self._write_every, self._clock = recorded, fatal, write_every, clock
        self._unwritten: deque[Record] = deque(maxlen=2 * MOST_GOALS)
        self._due = 0.0  # of the next transaction; the first one opens the file, and detects damage
        self.file = LedgerFile(path, actuators, self.owed)
        self._queue: SimpleQueue[Record | None] = SimpleQueue()  # None: the end
        self._thread = threading.Thread(target=self._run, name="ledger", daemon=True)
        if threaded:
            self._thread.start()

    def record(self, record: Record) -> None:
        """Queues a goal, its result, or both; later `recorded` is called with the record's number."""
        self._queue.put(record)

    def counts(self, counts: Sequence[int]) -> None:
        """Stores the executor's counts, one for each actuator; a count never falls. For one thread."""
        if len(counts) != len(self.known):
            log.error("the executor counts %d actuators, the ledger %d", len(counts), len(self.known))
            return
        self.known = tuple(map(max, self.known, counts))

    def faults(self) -> tuple[Fault, ...]:
        problems = (("ledger-unwritten", self.fault), ("ledger-damaged", self.damage))
        return tuple(Fault(code, "ledger", message) for code, message in problems if message is not None)

    def close(self, timeout: float = 5.0) -> None:
        self._queue.put(None)
        if self._thread.ident is not None:
            self._thread.join(timeout)
        self.unlock()

    def unlock(self) -> None:
        """Lets another process write the ledger."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _run(self) -> None:
        try:
            while self.write_waiting(min(self._due - self._clock(), LOOK_EVERY)):
                pass
        except Exception as error:
            log.exception("the ledger's thread ended")
            self._fatal(f"the ledger's thread ended: {error!r}")
        finally:
            self.file.close()

    def write_waiting(self, longest: float = 0.0) -> bool:
        """Waits up to `longest` [s] for a record, and writes what is due; returns False at the end."""
        waiting = list[Record | None]()
        with suppress(Empty):
            waiting.append(self._queue.get(timeout=max(longest, 0.0)))
            waiting += [self._queue.get() for _ in range(self._queue.qsize())]
        records = [record for record in waiting if record is not None]
        self._unwritten.extend(records)
        if waiting or self._clock() >= self._due or self.file.is_gone():
            if self._write(self._unwritten):
                self._unwritten.clear()
            for record in records:
                self._recorded(record.entry)
            self._due = self._clock() + self._write_every
        return None not in waiting

    def _write(self, records: Sequence[Record]) -> bool:
        for _ in range(2):  # the second time into a new file, if the old one is damaged
            try:
                self.file.write(records, self.known)
                self.fault = None
                return True
            except Exception as error:
                self.file.close()
                if not damaged(error) or (told := self.file.set_aside(error)) is None:
                    if self.fault is None:
                        log.error("ledger %s cannot be written, counting continues in memory: %s", self._path, error)
                    self.fault = f"ledger {self._path} cannot be written: {error}"
                    return False
                self.damage = told
        return False


def locked(ledger: Path) -> int | None:
    """Returns the descriptor of the locked file "<ledger>.lock"; None if it cannot be made.

    The ledger itself cannot carry the lock: closing another file descriptor of it would drop SQLite's own locks.
    """
    path = ledger.with_name(f"{ledger.name}.lock")
    try:
        return lock_file(path, f"end the other daemon first: the ledger {ledger} is in use by process")
    except OSError as error:
        log.warning("%s: no lock on the ledger: %s", path, error.strerror)
        return None


class Mark(NamedTuple):  # a published result, one JSON array in a line
    instance: int
    program: int
    status: str
    code: int
    message: str
    switches: int


class PublishedResults:
    """Marks of the newest results, made before each is published, in memory and in a file.

    After the start only the outbox's thread uses it.

    A planner may be killed before the executor gets the acknowledgement of a result. Then the next planner finds the
    mark. If the ledger has the result, that planner does not publish it again; otherwise it tells clients that the
    result is repeated. The file needs no fsync: it survives the death of the process, and a reboot deletes the
    executor's results as well.

    The file has at most twice MOST_MARKS lines. Torn lines and other text are ignored. Its folder is in memory, and
    must exist.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._warned = path, False
        try:
            content = read_file(path)
        except OSError:  # the first start
            content = b""
        self._marks = {Identity(*mark[:2]): mark for mark in map(decoded, content.splitlines()) if mark is not None}

    def known(self) -> dict[Identity, ResultEntry]:
        """Returns the marked results by program; their times are unknown."""
        return {identity: ResultEntry(0.0, *mark[2:]) for identity, mark in self._marks.items()}

    def add(self, identity: Identity, result: Result) -> None:
        """Marks a result, in about 10 us. If the file cannot be written, the mark is in memory only."""
        mark = Mark(*identity, result.status, result.code, plain(result.message), result.switches)
        self._marks[identity] = mark
        if len(self._marks) > 2 * MOST_MARKS:
            self._marks = dict(list(self._marks.items())[-MOST_MARKS:])
            new = self._path.with_name(f"{self._path.name}.new")
            self._write(new, os.O_TRUNC, msgspec.json.Encoder().encode_lines(self._marks.values()), self._path)
        else:
            self._write(self._path, os.O_APPEND, b"\n" + msgspec.json.encode(mark))  # the line before may be torn

    def _write(self, path: Path, flag: int, data: bytes, target: Path | None = None) -> None:
        """Writes data. The file is opened each time: systemd may have deleted the folder, and made it again."""
        try:
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | flag, 0o600)
            try:
                if os.write(file, data) < len(data):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            finally:
                os.close(file)
            if target is not None:
                os.replace(path, target)
        except OSError as error:
            if not self._warned:
                log.warning("%s: %s; a planner that is killed may publish a result twice", path, error.strerror)
            self._warned = True


def published_path(arm: str, socket: Path) -> Path:
    """Returns the path of an arm's marks: in systemd's RuntimeDirectory, otherwise beside the executor's socket."""
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return (Path(folder) if folder else socket.parent) / f"{arm}.published"


def decoded(line: bytes) -> Mark | None:
    try:
        return decode(line, Mark)
    except Unreadable:
        return None
