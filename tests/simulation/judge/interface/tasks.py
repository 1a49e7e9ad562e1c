"""Tasks of the workers, and where they start."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from hyperbit.controller.program import Snapshot, pack, unpack
from tests.simulation.judge.interface.facts import Payload, Ran, Request
from tests.simulation.judge.interface.modules import Cube


@dataclass(eq=False)
class Search:
    """A task of a worker.

    Attributes:
        kind: "goal", "plan", "prepare", "follow", "improve", "stages", "standing", "scene" or "tables".
        start: outputs, commanded states, states to plan from, and locks, packed; empty: it has no start.
        tables: locked state of each actuator, 255 if it is free.
        cubes: obstacles; None: it has none.
        goal: id, waypoints, deadline and time of arrival of a goal.
        improves: whether a running plan is to be improved; None: the task is another one.
        tolerance: of a followed set-point.
    """

    number: int
    kind: str
    start: tuple[bytes, ...] = ()
    tables: bytes = b""
    cubes: tuple[Cube, ...] | None = None
    goal: Payload | None = None
    bias: tuple[float, ...] | None = None
    states: tuple[bytes, ...] = ()
    improves: bool | None = None
    tolerance: float = 0.0
    at: float = 0.0
    awake: float = 0.0
    hurried: bool = False
    abandoned: bool = False
    abandoned_in: float = math.inf  # step of the core
    stale_from: float = math.inf
    ran: Ran | None = None  # that is improved


def start_of(snapshot: Snapshot, size: int) -> tuple[bytes, ...]:
    """Returns outputs, commanded states, the states to plan from, and the locks of a snapshot, packed."""
    known, locked = unpack(snapshot.known), unpack(snapshot.locked)
    measured, outputs = unpack(snapshot.measured), unpack(snapshot.outputs)
    held = locked & known
    commanded = measured & held | outputs & ~held
    states = commanded if snapshot.moving else measured & known | commanded & ~known
    return snapshot.outputs, pack(commanded, size), pack(states, size), snapshot.locked


def tables_of(snapshot: Snapshot, size: int) -> bytes:
    """Returns the locked state of each actuator, 255 if it is free or not known."""
    held, measured = unpack(snapshot.locked) & unpack(snapshot.known), unpack(snapshot.measured)
    return bytes(measured >> k & 1 if held >> k & 1 else 255 for k in range(size))


def basis(search: Search) -> tuple[Any, ...]:
    """Returns what a prepared search holds for."""
    return search.start, search.tables, search.cubes


def asks(request: Request, goal: Payload) -> bool:
    waypoints = request.body.get("waypoints")
    if not isinstance(waypoints, list) or len(waypoints) != len(goal["waypoints"]) or request.goal != goal["id"]:
        return False
    names = ("position", "orientation", "configuration")
    return all(
        all(mine.get(name) == theirs.get(name) for name in names) and float(mine.get("t", 0.0)) == theirs["t"]
        for mine, theirs in zip(waypoints, goal["waypoints"], strict=True)
    )
