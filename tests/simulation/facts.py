"""Facts of the world, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from controller.program import Accepted, Ended, Program
from drivers.canopen.wire.cia301 import Frame


@dataclass
class Running:
    """An accepted program; `last` is the stage that the boards have reached."""

    number: int
    begin: float
    strict: bool
    stages: list[tuple[int, float]]  # states, and their earliest times
    last: int = -1


@dataclass
class Commit:
    """RPDOs and the SYNCs after them, with requests and locked actuators at the time of the RPDOs."""

    began: float
    locked: int
    locked_states: int
    realigns: bool  # something was requested, and outputs of locked actuators differed from their locked states
    running: Running | None
    candidates: list[tuple[int, int]]  # index and states of the requested stages
    homing: int = 0  # mask of the actuators of unknown state that a request brings to `homes`
    homes: int = 0
    releases: bool = False  # a pulse was on
    synced_at: float | None = None
    switched: int = 0


class Switch(NamedTuple):
    """Changed outputs. `cause` is "SYNC", another frame, "time" or "fault"."""

    mask: int
    after: int
    cause: str
    bus: str
    commit: Commit | None


class Energised(NamedTuple):
    """Coils of actuators with two coils: those that came on, all that are on, and those that came on without effect.

    `cause` is that of `Switch`.
    """

    came: int
    on: int
    again: int
    cause: str
    bus: str
    commit: Commit | None


@dataclass
class Step:
    """The facts of the last step of the world."""

    frames: list[tuple[str, Frame]] = field(default_factory=list)
    switches: list[Switch] = field(default_factory=list)
    energised: list[Energised] = field(default_factory=list)
    accepted: list[tuple[Program, Accepted]] = field(default_factory=list)
    ended: list[Ended] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    epochs: list[tuple[int, int]] = field(default_factory=list)  # shown epoch, and the least correct one
