"""The account of the planner's side: requests and answers, programs, snapshots that came, and what disturbed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from controller.program import Ended, Program, Settled, Snapshot, unpack
from tests.simulation.judge.interface.modules import Cube, JudgedModules

Payload = dict[str, Any]
DELAY = 0.1  # [s], awake, from an event of the world to a `state` that tells it: 20 states a second, and the outbox


@dataclass(eq=False)
class Request:
    """A request as it came.

    Attributes:
        number: in the order of arrival.
        process: number of the planner's process.
        body: its payload, if that is a JSON object.
        at: time of arrival; `awake` is the process's awake time then [s].
        answer: that has left the daemon; None before.
        original: the request that it repeats; None: it is new.
    """

    number: int
    process: int
    client: int
    key: str
    name: str
    query: bool
    payload: bytes
    attachment: bytes
    body: Payload
    sent_at: float
    at: float
    awake: float
    answer: Payload | None = None
    answered_at: float = math.inf
    original: Request | None = None
    doubtful: bool = False  # whether it may count as a repetition or as new
    cubes: tuple[Cube, ...] = ()  # of obstacles
    shown: int = 0  # number of obstacles in the state before

    @property
    def accepted(self) -> bool:
        """Whether the answer says that it is carried out."""
        return self.answer is not None and bool(self.answer.get("accepted"))

    @property
    def goal(self) -> str | None:
        """The id that the client gave."""
        name = self.body.get("id")
        return name if isinstance(name, str) else None

    def __str__(self) -> str:
        return f"{self.key} {self.number} ({self.payload[:120].decode(errors='replace')})"


@dataclass(eq=False)
class Ran:
    """A program that the executor has accepted.

    Attributes:
        goal: the id in its name.
        states: of the boards when it was accepted.
        cubes: all obstacles that may have been in force then.
        process: of the planner that sent it.
        exact: whether the arm surely was in `states`.
        marks: of its stages.
        begun_marks: marks to which stages have begun, with the awake times at which the planner heard of them.
        settled: marks that were told, with the awake times at which the planner got them.
        heard_at: time at which the planner heard of its end.
        recorded: whether the ledger has its result.
        given_up: whether the planner has refused it and canceled it.
        switches: switched by SYNC.
        request: to which it belongs, as soon as that is answered.
    """

    instance: int
    process: int
    program: Program
    goal: str
    jog: bool
    at: float
    awake: float
    states: int
    locked: int
    cubes: tuple[Cube, ...]
    exact: bool
    marks: list[int] = field(default_factory=list)
    stage: int = -1
    begun_marks: list[tuple[int, float]] = field(default_factory=list)
    settled: dict[int, tuple[Settled, float]] = field(default_factory=dict)
    ended: Ended | None = None
    ended_at: float = math.inf
    heard_at: float = math.inf
    heard_awake: float = math.inf
    accepted_awake: float = math.inf
    recorded: bool = False
    switches: int = 0
    request: Request | None = None
    feedback: list[Payload] = field(default_factory=list)
    results: list[Payload] = field(default_factory=list)
    given_up: bool = False

    @property
    def key(self) -> tuple[int, int]:
        """Identity of the program."""
        return self.instance, self.program.program


class Heard(NamedTuple):
    """A snapshot that the planner's process got, or None: the connection ended."""

    at: float
    awake: float
    snapshot: Snapshot | None


class InterfaceAccount:
    """What the judge knows of the planner's side.

    Attributes:
        now: time [s].
        process: number of the present process of the planner; 0 between two.
        requests: all of the present process that may still matter.
        programs: accepted by executors, by identity.
        heard: snapshots of the present process, the newest last.
        cubes: the obstacles in force, of the last request that was carried out.
        clear: returns whether nothing disturbs the world.
        sure: returns whether planner and executor know the states of all actuators.
        interlock_open: returns whether an interlock is open, or was a moment ago.
        silent_after: time without a message of the executor, after which it counts as lost [s].
        bias: tip bias that the daemon tells; None: no tracker.
        shown_obstacles: number in the last state.
        scenes: number of scenes that workers build.

    Args:
        modules: the arm.
        wall: returns the UNIX time [s].
        driven: returns the states to which the boards drive the actuators.
    """

    def __init__(
        self, modules: JudgedModules, wall: Callable[[], float], driven: Callable[[], int], clear: Callable[[], bool]
    ) -> None:
        self.modules, self.wall, self.driven, self.clear = modules, wall, driven, clear
        self.now, self.process, self.instance = 0.0, 0, 0
        self.tolerance = self.length = self.longest_transition = 0.0
        self.silent_after = math.inf
        self.sure = clear
        self.interlock_open: Callable[[], bool] = lambda: False
        self.bias: tuple[float, ...] | None = None
        self.ledger_counts: tuple[int, ...] = ()
        self.disk_failed = False
        self.numbers = 0
        self.requests: list[Request] = []
        self.programs: dict[tuple[int, int], Ran] = {}
        self._last: dict[str, tuple[float, float]] = {}  # time and awake time of the last event of each kind
        self._still_from = self._still_until = self._still = 0.0
        self.declared = bytes([255]) * len(modules.labels)
        self.begin(0)

    def begin(self, process: int) -> None:
        """A process of the planner begins."""
        self.process, self.began_at = process, self.now
        self.requests = []
        self.heard = deque([Heard(self.now, self.awake, None)], maxlen=400)
        self.cubes: tuple[Cube, ...] = ()
        self.cubes_number, self.cubes_at = 0, self.now
        self.quits = False
        self.scenes = self.shown_obstacles = 0
        self.setpoints = 0
        self.counts_at_start: int | None = None
        self._tables, self._needed, self._failed = self.declared, self.declared, False

    # --- time

    @property
    def awake(self) -> float:
        """Time for which processes of the planner were not halted [s]."""
        return self.now - self._still - max(min(self.now, self._still_until) - self._still_from, 0.0)

    def stands_still(self, until: float) -> None:
        """The process is halted from now on until a time [s]."""
        if self.now < self._still_until:
            self._still_until = max(self._still_until, until)
        else:
            self._still += max(self._still_until - self._still_from, 0.0)
            self._still_from, self._still_until = self.now, until
        self.note("still", until)

    def note(self, kind: str, at: float | None = None) -> None:
        """Records the time of an event [s]."""
        self._last[kind] = self.now if at is None else at, self.awake

    def had(self, kind: str, since: float) -> bool:
        """Returns whether there was an event of a kind since a time [s]."""
        return kind in self._last and self._last[kind][0] >= since

    def lately(self, kind: str, seconds: float) -> bool:
        """Returns whether there was an event of a kind in the last seconds that the process was awake."""
        return kind in self._last and self._last[kind][1] >= self.awake - seconds

    # --- what held

    def hears(self, snapshot: Snapshot | None) -> None:
        """The process gets a snapshot, or its connection ends."""
        self.heard.append(Heard(self.now, self.awake, snapshot))

    def truths(self, delay: float = DELAY) -> Iterator[Heard]:
        """Yields the snapshots that held at some time in the last seconds that the process was awake, newest first."""
        since = self.awake - delay
        for heard in reversed(self.heard):
            yield heard
            if heard.awake < since:
                return

    @property
    def snapshot(self) -> Snapshot | None:
        """The newest snapshot."""
        return self.heard[-1].snapshot

    def waiting(self, *keys: str) -> list[Request]:
        """Returns the queries on these keys that are not answered."""
        return [r for r in self.requests if r.query and r.answer is None and r.key in keys]

    def ran(self, goal: str) -> list[Ran]:
        """Returns the programs of a goal's id, the oldest first."""
        return [ran for ran in self.programs.values() if ran.goal == goal]

    # --- tables and obstacles

    def needs_tables(self, snapshot: Snapshot) -> None:
        """Records for which locked states the planner needs tables."""
        everything = (1 << len(self.modules.labels)) - 1
        known, locked, measured = unpack(snapshot.known), unpack(snapshot.locked), unpack(snapshot.measured)
        if known | unpack(snapshot.homing) != everything or snapshot.moving:
            return
        held = locked & known
        needed = bytes(measured >> k & 1 if held >> k & 1 else 255 for k in range(len(self.modules.labels)))
        if needed != self._needed:
            self._needed, self._failed = needed, False
            self.note("tables")

    def takes_tables(self, locked: bytes | None) -> None:
        """Records that tables were built for locked states; None: that failed."""
        self._failed = locked is None
        self._tables = self._tables if locked is None else locked
        self.note("tables")

    @property
    def building(self) -> bool:
        """Whether the tables are not those for the present locks, or were not a moment ago."""
        return self._tables != self._needed or self.lately("tables", DELAY)

    @property
    def scene_building(self) -> bool:
        """Whether a worker builds a scene."""
        return self.scenes > 0

    @property
    def build_failed(self) -> bool:
        """Whether the last attempt to build tables has failed."""
        return self._failed or self.had("task failed", self.now - 1.0)

    def known_cubes(self, request: Request | None) -> set[Cube]:
        """Returns all obstacles that may be in force, or were since a request came."""
        cubes = set(self.cubes)
        for other in self.requests:
            pending = other.answer is None or (request is not None and other.answered_at >= request.at)
            if other.key == "obstacles" and pending:
                cubes |= set(other.cubes)
        return cubes
