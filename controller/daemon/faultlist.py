"""The faults since the last reset, each kept once by its code and source."""

import logging

from drivers.faults import Fault

PASSING = {"bus-down", "bus-off", "bus-busy", "board-lost", "board-missing"}  # codes

log = logging.getLogger(__name__)


class FaultList:
    """What is wrong with the arm, in the order in which it was told. The control loop's.

    Args:
        others: codes that need nobody's look either, beside PASSING.
    """

    def __init__(self, others: frozenset[str] = frozenset()) -> None:
        self._passing = PASSING | others
        self._faults: dict[tuple[str, str], Fault] = {}

    def __bool__(self) -> bool:
        return bool(self._faults)

    def __contains__(self, fault: Fault) -> bool:
        return (fault.code, fault.source) in self._faults

    def add(self, fault: Fault) -> None:
        """Takes a fault, and writes it to the journal when it is new."""
        if fault not in self:
            log.error("%s: %s", fault.code, fault.message)
        self._faults.setdefault((fault.code, fault.source), fault)

    def clear(self) -> None:
        """Forgets them all."""
        self._faults.clear()

    @property
    def passing(self) -> bool:
        """Whether nothing is wrong but what needs nobody's look: a bus or a board not heard, which passes by itself."""
        return all(code in self._passing for code, _ in self._faults)

    def all(self) -> tuple[Fault, ...]:
        """Returns them, the first first."""
        return tuple(self._faults.values())

    def sentence(self) -> str:
        """Returns the first one's message, and how many there are beside it."""
        first, *others = self._faults.values()
        return first.message + (f" (and {len(others)} more)" if others else "")
