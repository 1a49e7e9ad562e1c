"""A single fault: how it is caused and mended, and what must be told of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from tests.simulation.judge.expected import Expected

AT_ONCE = 0.05  # [s] until a frame on a slow bus, or a change of a bus, is told
READ_BACK = 2.0  # [s] until outputs that do not follow are told: about a second, and eight reads
READ_AT_ONCE = 0.75  # [s], likewise if no end-stop tells: eight reads
ASKED = 0.3  # [s] until the boards of a late actuator were asked


def nothing() -> None:
    """Mends a fault that is over at once."""


class Fault(NamedTuple):
    """A fault that can be caused and mended; neither the fault nor the reset after it changes what `holds` returns."""

    cause: Callable[[], object]
    mend: Callable[[], object]
    expected: Expected
    holds: Callable[[], object] = nothing


def codes(*names: str) -> frozenset[str]:
    return frozenset(names)


NO_FAULT = Expected(codes(), (), 0.0)
