"""What is handed to the control loop: all it acts on besides time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from controller.motion.plan import Plan
from drivers.faults import Fault

Payload = Mapping[str, Any]
Reply = Callable[[Payload], None]


@dataclass(frozen=True, eq=False)
class Planned:
    """A goal that has a plan and asks to be run; `arrival` is its place among all requests."""

    id: str
    plan: Plan
    arrival: int
    reply: Reply


@dataclass(frozen=True, eq=False)
class Cancel:
    """Hold now, and take no goal that arrived before."""

    arrival: int
    reply: Reply


@dataclass(frozen=True, eq=False)
class Stop:
    """Emergency stop."""

    arrival: int
    reply: Reply


@dataclass(frozen=True, eq=False)
class Reset:
    """Leave a fault or a stop."""

    arrival: int
    reply: Reply


@dataclass(frozen=True, eq=False)
class Started:
    """The boards' start-up has ended; with no faults all are operational."""

    faults: tuple[Fault, ...]


@dataclass(frozen=True, eq=False)
class Quit:
    """The service is asked to end."""


Event = Planned | Cancel | Stop | Reset | Started | Quit | Fault
