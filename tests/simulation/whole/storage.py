"""What survives a planner's process: its files, in a folder in memory that ends with the world."""

from __future__ import annotations

import resource
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from operator import ge
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from unittest import mock

from hyperbit.controller.gateway.poses import Poses
from hyperbit.controller.host import files
from hyperbit.controller.planning.core.events import Record
from hyperbit.controller.planning.ledger import Ledger, PublishedResults
from tests.simulation.agenda import Agenda
from tests.simulation.verdict import require

MEMORY = Path("/dev/shm")
Row = tuple[str, int, str, float]  # status, code, message and time of a result
DAMAGED = b"{", b"\xff", b'{"": {}}', b"[]"  # files of poses
LOOK_EVERY = 0.5  # [s] between two looks of the ledger's thread
OWED = "SELECT count(*) FROM goals WHERE ended IS NULL"
KEPT = "SELECT status, code, message, ended FROM goals WHERE instance = ? AND program = ?"


class Storage:
    """The files of the planner's processes.

    Attributes:
        ledger: of the present process; else of the last one.
        room: number of further transactions of the ledger, after which the disk is full; None: any number.
    """

    def __init__(self, actuators: tuple[str, ...], random: Random) -> None:
        self._actuators, self._random = actuators, random
        self._folder = TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None)
        folder = Path(self._folder.name)
        self.path, self._poses, self._published = folder / "arm.sqlite", folder / "arm.poses.json", folder / "published"
        self.ledger: LateLedger | None = None
        self.room: int | None = None
        self._owed: tuple[object, bool] = None, False  # version of the ledger, and whether it owed results
        self._killed = list[LateLedger]()  # their connections stay open: what a kill interrupts closes no file

    @property
    def counts(self) -> tuple[int, ...]:
        return (0,) * len(self._actuators) if self.ledger is None else self.ledger.known

    def begin(self, agenda: Agenda, recorded: Callable[[int], None]) -> LateLedger:
        """Opens the ledger for the next process."""
        if self.ledger is not None:
            self.ledger.kill()
            self._killed.append(self.ledger)
        self.ledger = LateLedger(self, agenda, self._random, self._actuators, recorded)
        return self.ledger

    def published(self) -> PublishedResults:
        return PublishedResults(self._published)

    def poses(self) -> Poses:
        """Reads the saved poses, whose file was damaged by somebody at times."""
        if self._random.random() < 0.1:
            self._poses.write_bytes(self._random.choice(DAMAGED))
        with mock.patch.object(files.log, "disabled", True):
            return Poses(self._poses, "home of the model")

    def has(self, instance: int, program: int) -> tuple[bool, Row | None]:
        """Returns whether the ledger has the acceptance of a program, and the row of its result."""
        if not self.path.exists():
            return False, None
        with closing(sqlite3.connect(self.path)) as connection:
            row = connection.execute(KEPT, (instance, program)).fetchone()
        return row is not None, row if row and row[0] else None

    def owes(self) -> bool:
        """Returns whether the ledger has goals without a result; reads it only after a write."""
        version = None if self.ledger is None else (id(self.ledger), self.ledger.written)
        if version != self._owed[0] and self.path.exists():
            with closing(sqlite3.connect(self.path)) as connection:
                self._owed = version, bool(connection.execute(OWED).fetchone()[0])
        return self._owed[1]

    @contextmanager
    def disk(self) -> Iterator[None]:
        """While it is full, no file grows, or only some bytes more are written."""
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        if self.room is not None:
            self.room -= 1
            if self.room < 0:
                resource.setrlimit(resource.RLIMIT_FSIZE, (self._random.choice([0, 5_000]), limits[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)

    def fill(self, room: int | None) -> None:
        """Lets the disk be full after some transactions, or no longer: another file of poses cannot be begun."""
        self.room, fresh = room, self._poses.with_name(f".{self._poses.name}.{files.os.getpid()}")
        if room is not None and not fresh.is_dir():
            fresh.unlink(missing_ok=True)
            fresh.mkdir()
        elif room is None and fresh.is_dir():
            fresh.rmdir()


class LateLedger(Ledger):
    """The ledger of one process, whose thread writes after drawn times.

    Attributes:
        written: number of its looks and writes so far.

    Args:
        recorded: see Ledger.
    """

    def __init__(
        self,
        storage: Storage,
        agenda: Agenda,
        random: Random,
        actuators: tuple[str, ...],
        recorded: Callable[[int], None],
    ) -> None:
        self._storage, self._agenda, self._random, self._tell = storage, agenda, random, recorded
        self._entries, self.written, self._last, self._alive = list[int](), 0, 0.0, True
        told, clock = self._entries.append, lambda: agenda.now
        super().__init__(storage.path, actuators, told, write_every=LOOK_EVERY, clock=clock, threaded=False)
        self._look()

    def counts(self, counts: Sequence[int]) -> None:
        before = self.known
        super().counts(counts)
        require(all(map(ge, self.known, before)), f"the counts of the ledger fall from {before} to {self.known}")

    def record(self, record: Record) -> None:
        super().record(record)
        delay = self._random.choice([0.0005, 0.002, 0.002, 0.05, 0.3])
        self._last = max(self._last, self._agenda.now + self._random.uniform(0.0, delay))
        self._agenda.at(self._last, self.write)

    def _look(self) -> None:
        if self._alive:
            self.write()
            self._agenda.after(LOOK_EVERY, self._look)

    def write(self) -> None:
        """Writes what waits, unless the process has ended; then tells what was recorded."""
        if self._alive:
            with self._storage.disk():
                self.write_waiting()
            self.written += 1
            while self._entries:
                self._tell(self._entries.pop(0))

    def kill(self) -> None:
        """Ends the ledger with its process: what waits is lost."""
        if self._alive:
            self._alive = False
            self.unlock()

    def finish(self) -> None:
        """Ends the ledger in order."""
        self.write()
        self.file.close()
        self.kill()
