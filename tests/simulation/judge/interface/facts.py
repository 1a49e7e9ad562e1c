"""What the judge knows of one request, of one program, and of one snapshot that came."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from hyperbit.controller.program import Ended, Program, Settled, Snapshot
from tests.simulation.judge.interface.modules import Cube

Payload = dict[str, Any]


@dataclass(eq=False)
class Request:
    """A request as it came.

    Attributes:
        number: in the order of arrival.
        body: its payload, if that is a JSON object.
        at: time of arrival; `awake` is the process's awake time then [s].
        answer: that has left the daemon; None before.
        original: the request that it repeats; None: it is new.
        regions: obstacles that may have been in force when a query of `arm` came.
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
    among: tuple[Cube, ...] = ()  # that were in force when it came
    regions: list[Any] = field(default_factory=list)
    shown: int = 0  # number of obstacles in the state before
    expected: str = ""  # reason of the refusal of a request on poses; "": it is carried out

    @property
    def accepted(self) -> bool:
        return self.answer is not None and bool(self.answer.get("accepted"))

    @property
    def goal(self) -> str | None:
        name = self.body.get("id")
        return name if isinstance(name, str) else None

    def __str__(self) -> str:
        return f"{self.key} {self.number} ({self.payload[:120].decode(errors='replace')})"


@dataclass(eq=False)
class Ran:
    """A program that the executor has accepted.

    Attributes:
        states: of the boards when it was accepted.
        cubes: all obstacles that may have been in force then.
        process: of the planner that sent it.
        exact: whether the arm surely was in `states`.
        marks: of its stages.
        begun_marks: marks to which stages have begun, with the awake times at which the planner heard of them.
        settled: marks that were told, with the awake times at which the planner got them.
        heard_at: time at which the planner heard of its end.
        seen: whether the planner had a snapshot when it heard of its end.
        heard_by: number of the last process of the planner that heard of its end.
        recorded_at: time at which the ledger had its result [s].
        given_up: whether the planner has refused it and canceled it.
        told_awake: awake time of the publication of its result [s].
        planned: switches that its answer told.
        homed: switches before them that its answer told.
        replaced: whether the planner has sent other stages.
        places: mark of each waypoint, if straight lines are followed.
        deviations: of the transitions to its points, as a worker has told; None: not known.
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
    seen: bool = False
    heard_by: int = 0
    recorded_at: float = math.inf
    switches: int = 0
    request: Request | None = None
    feedback: list[Payload] = field(default_factory=list)
    results: list[Payload] = field(default_factory=list)
    given_up: bool = False
    told_awake: float = math.inf
    planned: int | None = None
    homed: int = 0
    replaced: bool = False
    deviations: tuple[float | None, ...] = ()
    places: dict[int, int] = field(default_factory=dict)

    @property
    def recorded(self) -> bool:
        return self.recorded_at < math.inf

    def mark(self, waypoint: int) -> int:
        """Returns the mark of a waypoint: points between waypoints have marks, too, if straight lines are followed."""
        return self.places.get(waypoint, waypoint)

    def waypoint(self, mark: int) -> int:
        """Returns the last waypoint at or before a mark; -1 before the first."""
        if not self.places:
            return mark
        return max((k for k, place in self.places.items() if place <= mark), default=-1)

    @property
    def key(self) -> tuple[int, int]:
        return self.instance, self.program.program


class Made(NamedTuple):
    """What the planner knew as it sent a program: snapshot, times of the switches, obstacles surely in force."""

    snapshot: Snapshot | None
    switched_at: tuple[float, ...]
    cubes: set[Cube]


class Heard(NamedTuple):
    """A snapshot that the planner's process got, or None: the connection ended."""

    at: float
    awake: float
    snapshot: Snapshot | None
