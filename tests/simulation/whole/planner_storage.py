"""What survives a planner's process: the ledger, the marks of published results; and the threads that write them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random

from controller.gateway.outbox import SENT_WITHIN
from controller.planning.core.events import (
    AcceptanceEntry,
    Event,
    Identity,
    OpenGoal,
    Payload,
    Published,
    PublishResult,
    Record,
    Recorded,
    ResultEntry,
)
from tests.simulation.agenda import Agenda

TRANSMITTED = 0.02  # [s] in which a put leaves the process


@dataclass
class Row:
    """A goal in the ledger."""

    accepted: AcceptanceEntry | None = None
    ended: ResultEntry | None = None


class Storage:
    """What survives a planner's process.

    Attributes:
        rows: of the ledger.
        counts: of switches.
        published: marks of published results, by program.
        full: whether the disk is full.
    """

    def __init__(self, actuators: int) -> None:
        self.rows: dict[Identity, Row] = {}
        self.counts = (0,) * actuators
        self.published: dict[Identity, ResultEntry] = {}
        self.full = False

    def write(self, record: Record) -> None:
        """Writes a record."""
        row = self.rows.setdefault(record.identity, Row())
        row.accepted, row.ended = row.accepted or record.accepted, row.ended or record.ended

    def owed(self) -> list[OpenGoal]:
        """Returns the goals without a result."""
        return [
            OpenGoal(identity, row.accepted.goal, row.accepted.wall, row.accepted.waypoints)
            for identity, row in self.rows.items()
            if row.accepted is not None and row.ended is None
        ]


class SimulatedLedger:
    """The ledger's thread of one process.

    Args:
        agenda: time.
        random: for delays.
        storage: of the world.
        alive: returns whether the process lives.
        post: takes events.
        note: takes what was recorded.
    """

    def __init__(
        self,
        agenda: Agenda,
        random: Random,
        storage: Storage,
        alive: Callable[[], bool],
        post: Callable[[Event], None],
        note: Callable[[Record], None],
    ) -> None:
        self._agenda, self._random, self._storage, self._alive, self._post = agenda, random, storage, alive, post
        self._note = note
        self._unwritten: list[Record] = []
        self._last = 0.0

    def record(self, record: Record) -> None:
        """Writes a record after a while, and posts `Recorded`, also if the disk is full."""

        def write() -> None:
            if self._alive():
                self._unwritten.append(record)
                self.flush()
                self._note(record)
                self._post(Recorded(record.entry))

        delay = self._random.choice([0.0005, 0.002, 0.002, 0.05, 0.3])
        self._last = max(self._last, self._agenda.now + self._random.uniform(0.0, delay))
        self._agenda.at(self._last, write)

    @property
    def waits(self) -> bool:
        """Whether records could not be written."""
        return bool(self._unwritten)

    def counts(self, counts: Sequence[int]) -> None:
        """Writes counts."""
        self._storage.counts = tuple(map(max, self._storage.counts, counts))

    def flush(self) -> None:
        """Writes what waits, unless the disk is full."""
        if not self._storage.full:
            for record in self._unwritten:
                self._storage.write(record)
            self._unwritten.clear()


class SimulatedOut:
    """The thread that publishes.

    Args:
        agenda: time.
        random: for delays.
        storage: of the world.
        alive: returns whether the process lives.
        post: takes events.
        told: takes each published result.
        shown: takes all other payloads.
    """

    def __init__(
        self,
        agenda: Agenda,
        random: Random,
        storage: Storage,
        alive: Callable[[], bool],
        post: Callable[[Event], None],
        told: Callable[[PublishResult], None],
        shown: Callable[[str, Payload], None],
    ) -> None:
        self._agenda, self._random, self._storage, self._alive, self._post = agenda, random, storage, alive, post
        self._told, self.publish = told, shown

    def publish_result(self, result: PublishResult) -> None:
        """Marks a result after a while, puts it, and posts `Published`. A kill just after the put may lose it."""

        def put() -> None:
            if self._alive():
                payload = result.payload
                fields = payload["status"], payload["code"], payload["message"], payload["switches"]
                self._storage.published[result.identity] = ResultEntry(0.0, *fields)
                self._agenda.after(self._random.uniform(0.0, TRANSMITTED), transmit)
                self._agenda.after(SENT_WITHIN, post)

        def transmit() -> None:
            if self._alive():
                self._told(result)

        def post() -> None:
            if self._alive():
                self._post(Published(result.number))

        slow = 0.5 if result.inherited else 0.001
        self._agenda.after(self._random.uniform(0.0, self._random.choice([slow, slow, 0.2])), put)
