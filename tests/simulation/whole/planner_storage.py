"""What survives a planner's process: the ledger, the marks of published results; and the threads that write them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random

from hyperbit.controller.planning.core.events import (
    AcceptanceEntry,
    Event,
    Identity,
    Payload,
    Record,
    Recorded,
    ResultEntry,
)
from tests.simulation.agenda import Agenda


def nothing() -> None:
    """Does nothing."""


@dataclass
class Row:
    accepted: AcceptanceEntry | None = None
    ended: ResultEntry | None = None


class Storage:
    """What survives a planner's process.

    Attributes:
        published: marks of published results, by program.
        full: whether the disk is full.
        marked: is called after each mark, and after each record of a result.
        fills_at: number of further records after which the disk is full; None: it does not become full.
    """

    def __init__(self, actuators: int) -> None:
        self.fills_at: int | None = None
        self.rows: dict[Identity, Row] = {}
        self.counts = (0,) * actuators
        self.published: dict[Identity, ResultEntry] = {}
        self.full = False
        self.marked: Callable[[], None] = nothing

    def write(self, record: Record) -> None:
        row = self.rows.setdefault(record.identity, Row())
        row.accepted, row.ended = row.accepted or record.accepted, row.ended or record.ended
        if record.ended is not None:
            self.marked()

    def mark(self, identity: Identity, payload: Payload) -> None:
        fields = payload["status"], payload["code"], payload["message"], payload["switches"]
        self.published[identity] = ResultEntry(0.0, *fields)
        self.marked()

    def find(self, goal: str) -> Payload | None:
        """Returns the newest row of a goal, as the ledger's file has it."""
        rows = [row for row in self.rows.values() if row.accepted is not None and row.accepted.goal == goal]
        if not rows:
            return None
        ended = rows[-1].ended
        fields = ResultEntry(0.0, "", 0, "", 0) if ended is None else ended
        return {**fields._asdict(), "ended": None if ended is None else ended.wall}

    def owed(self) -> dict[Identity, AcceptanceEntry]:
        """Returns the goals without a result."""
        return {
            identity: row.accepted
            for identity, row in self.rows.items()
            if row.accepted is not None and row.ended is None
        }


class SimulatedLedger:
    """The ledger's thread of one process."""

    def __init__(
        self,
        agenda: Agenda,
        random: Random,
        storage: Storage,
        alive: Callable[[], bool],
        post: Callable[[Event], None],
    ) -> None:
        self._agenda, self._random, self._storage, self._alive, self._post = agenda, random, storage, alive, post
        self._unwritten: list[Record] = []
        self._last = 0.0

    def record(self, record: Record) -> None:
        """Writes a record after a while, and posts `Recorded`, also if the disk is full."""

        def write() -> None:
            if self._alive():
                self._unwritten.append(record)
                self.flush()
                self._post(Recorded(record.entry))

        delay = self._random.choice([0.0005, 0.002, 0.002, 0.05, 0.3])
        self._last = max(self._last, self._agenda.now + self._random.uniform(0.0, delay))
        self._agenda.at(self._last, write)

    @property
    def waits(self) -> bool:
        return bool(self._unwritten)

    def counts(self, counts: Sequence[int]) -> None:
        self._storage.counts = tuple(map(max, self._storage.counts, counts))

    def flush(self) -> None:
        """Writes what waits, unless the disk is full."""
        storage = self._storage
        if self._unwritten and storage.fills_at is not None:
            storage.fills_at -= 1
            storage.full |= storage.fills_at < 0
        if not storage.full:
            for record in self._unwritten:
                storage.write(record)
            self._unwritten.clear()
