"""Facts of the world, as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from tests.simulation.statements.motions import Sync


class Switch(NamedTuple):
    """Changed outputs. `cause` is "SYNC", another frame, "time", "fault" or "foreign START"; `sync` that SYNC."""

    mask: int
    after: int
    cause: str
    bus: str
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
    sync: Sync | None
