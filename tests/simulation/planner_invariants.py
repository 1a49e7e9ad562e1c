"""The invariants of the whole daemon."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.simulation.daemon import Daemon
    from tests.simulation.world import World

PLANNER_INVARIANTS: tuple[Callable[[World, Daemon], None], ...] = ()
