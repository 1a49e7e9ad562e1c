"""What is known of one request, and of one program that an executor has accepted."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec

from hyperbit.controller.program import Ended, Program, Settled, Snapshot, unpack
from tests.simulation.whole.configurations import Disc

Payload = dict[str, Any]


@dataclass(eq=False)
class Request:
    """A request as it came.

    Attributes:
        number: in the order of arrival at all processes.
        body: its payload, if that is a JSON object.
        sent: payload and attachment; None without an attachment.
        awake: awake time of its process at its arrival [s].
        waited: time without an answer in which the process was awake and nothing hindered it [s].
    """

    number: int
    key: str
    name: str
    query: bool
    body: Payload
    at: float
    awake: float
    drawn: tuple[str, ...] = ()  # "accepted", or the reasons of refusals for which it was drawn in calm
    answer: Payload | None = None
    answered_at: float = math.inf
    waited: float = 0.0
    sent: tuple[bytes, bytes] | None = None

    @property
    def accepted(self) -> bool:
        return self.answer is not None and bool(self.answer.get("accepted"))

    @property
    def goal(self) -> str | None:
        name = self.body.get("id")
        return name if isinstance(name, str) else None

    @property
    def patience(self) -> float:
        """Longest time until a goal or jog begins [s]."""
        own = self.body.get("begin_within")
        return float(8.0 + (self.body.get("deadline") or 0.0) if own is None else own)

    @property
    def lined(self) -> bool:
        return bool(self.body.get("path_tolerance"))

    @property
    def discs(self) -> frozenset[Disc]:
        return discs_of(self.body.get("regions") or [])

    def __str__(self) -> str:
        return f"{self.key} {self.number} {str(self.body)[:200]}"


@dataclass(eq=False)
class Ran:
    """A program that an executor has accepted.

    Attributes:
        request: for which it was made; None: several fit, or it is of an earlier process.
        start: from which it was planned, and its locked actuators; None: that is not sure.
        among: all obstacles that may have been in force when it was accepted.
        marks: of its stages.
        mark: that the last stage which has begun leads to; -1 before the first.
        told: what the planner was told of its settled marks, by mark.
        planned: switches that its answer told; None before.
        reached: waypoints of which feedback was told before the last state.
        over_at: awake time of its result [s]; `result_at` is its time.
    """

    instance: int
    process: int
    program: Program
    request: Request | None
    at: float
    awake: float
    start: tuple[int, int] | None
    among: frozenset[Disc]
    marks: list[int]
    mark: int = -1
    replaced: bool = False
    told: dict[int, Settled] = field(default_factory=dict)
    ended: Ended | None = None
    ended_at: float = math.inf
    planned: int | None = None
    feedback: list[Payload] = field(default_factory=list)
    reached: int = 0
    results: list[Payload] = field(default_factory=list)
    over_at: float = math.inf
    result_at: float = math.inf
    foretold: list[float] = field(default_factory=list)

    @property
    def given_up(self) -> bool:
        """Whether the planner has refused it, and canceled it."""
        return self.request is not None and self.request.answer is not None and not self.request.accepted

    @property
    def jog(self) -> bool:
        return self.program.name.startswith("jog ")

    @property
    def goal(self) -> str:
        return self.program.name.partition(" ")[2]


class Heard(NamedTuple):
    """A snapshot that came to the planner's process, or None: the connection ended."""

    awake: float
    snapshot: Snapshot | None


def discs_of(regions: list[Any]) -> frozenset[Disc]:
    return frozenset(Disc(*region["disc"]["centre"], region["disc"]["radius"]) for region in regions)


def states_from(snapshot: Snapshot) -> int:
    """Returns the states from which a goal is planned: unknown ones, and those in motion, as commanded."""
    known, measured = unpack(snapshot.known), unpack(snapshot.measured)
    held, sure = unpack(snapshot.locked) & known, 0 if snapshot.moving else known
    commanded = measured & held | unpack(snapshot.outputs) & ~held
    return measured & sure | commanded & ~sure


def body_of(payload: bytes) -> Payload:
    """Returns a payload that is a JSON object; an empty one otherwise."""
    try:
        found = msgspec.json.decode(payload)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def measured_of(known: bytes, measured: bytes, size: int) -> list[int | None]:
    """Returns the state of each actuator, None where it is not known."""
    return [unpack(measured) >> k & 1 if unpack(known) >> k & 1 else None for k in range(size)]
