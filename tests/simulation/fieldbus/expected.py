"""A single fault: how it begins and ends, and what the master must tell of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Expected(NamedTuple):
    """What must be told.

    Attributes:
        codes: one of them; none: nothing may be told.
        source: board or bus.
        words: in the sentence.
        within: [s] from the cause.
        lost: names of the boards whose states become unknown; empty: the master stays ready.
        also: codes that may be told as well.
        calm: whether the master's heartbeats must go on.
        least: [s] before which nothing may be told.
    """

    codes: tuple[str, ...]
    source: str = ""
    words: tuple[str, ...] = ()
    within: float = 0.3
    lost: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    calm: bool = True
    least: float = 0.0


class Fault(NamedTuple):
    """How a fault begins and ends, and what must be told; `check` is called when it was told."""

    cause: Callable[[], object]
    mend: Callable[[], object]
    expected: Expected
    check: Callable[[], object] = lambda: None


Makers = dict[str, Callable[[], Fault | None]]
