"""Facts of the world, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.judge.account import Commit

if TYPE_CHECKING:
    from tests.simulation.statements.account import Sync


class Switch(NamedTuple):
    """Changed outputs. `cause` is "SYNC", another frame, "time", "fault" or "foreign START"; `sync` that SYNC."""

    mask: int
    after: int
    cause: str
    bus: str
    commit: Commit | None
    sync: Sync | None


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
    sync: Sync | None


@dataclass
class Step:
    """The facts of the last step of the world."""

    frames: list[tuple[str, Frame]] = field(default_factory=list)
    switches: list[Switch] = field(default_factory=list)
    energised: list[Energised] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    @property
    def empty(self) -> bool:
        return not (self.frames or self.switches or self.energised or self.errors)
