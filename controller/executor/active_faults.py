"""Active faults: what is wrong since the last boot, each kept once by its code and source."""

from drivers.canopen.faults import Fault

PASSING = frozenset({"bus-down", "bus-off", "bus-busy", "board-lost", "board-missing"})  # codes


class ActiveFaults:
    """The faults of the arm in the order of their reports.

    Args:
        others: codes of faults that clear by themselves, beside PASSING.
    """

    def __init__(self, others: frozenset[str] = frozenset()) -> None:
        self._passing = PASSING | others
        self._faults: dict[tuple[str, str], Fault] = {}

    def __bool__(self) -> bool:
        return bool(self._faults)

    def add(self, fault: Fault) -> bool:
        """Adds a fault; returns whether it is new."""
        new = (fault.code, fault.source) not in self._faults
        self._faults.setdefault((fault.code, fault.source), fault)
        return new

    def clear(self) -> None:
        """Removes all."""
        self._faults.clear()

    @property
    def passing(self) -> bool:
        """Whether every active fault clears by itself: a bus or a board that is not heard."""
        return all(code in self._passing for code, _ in self._faults)

    def all(self) -> tuple[Fault, ...]:
        """Returns the faults, the oldest first."""
        return tuple(self._faults.values())

    def sentence(self) -> str:
        """Returns the oldest fault's message, and the number of the others."""
        first, *others = self._faults.values()
        return first.message + (f" (and {len(others)} more)" if others else "")
