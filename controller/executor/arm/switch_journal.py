"""The counts of an arm's switches. Each switch is counted exactly once."""

from collections.abc import Sequence

from hyperbit.controller.executor.arm.kinds import indices


class SwitchJournal:
    """Counts the switches of A actuators in memory. `FileJournal` keeps them.

    The intended states of a stage are recorded before its SYNC. A process killed after that leaves unknown whether the
    SYNC was sent; the next process finds out from the boards' outputs.
    """

    def __init__(self, actuators: int) -> None:
        self.counts = [0] * actuators  # number of switches of each actuator, shape (A,)
        self._intended = self._after = 0

    @property
    def problem(self) -> str | None:
        """Why counts were lost or will be lost, as a sentence; None if they are safe."""
        return None

    def __reduce__(self) -> tuple[object, ...]:
        """Pickles any journal as one in memory: files belong to the process."""
        state = {"counts": self.counts, "_intended": self._intended, "_after": self._after}
        return SwitchJournal, (len(self.counts),), state

    def intend(self, before: int, after: int) -> None:
        self._intended, self._after = before ^ after, after
        self._write()

    def resolve(self, states: int, unknown: int = 0) -> int:
        """Counts the intended switches that the outputs' `states` show, but none of `unknown`; returns their mask."""
        if not self._intended:
            return 0
        switched = self._intended & ~(self._after ^ states) & ~unknown
        for k in indices(switched):
            self.counts[k] += 1
        self._intended = 0
        self._write()
        return switched

    def raise_to(self, counts: Sequence[int]) -> None:
        """Raises counts (A,) to those of the planner's ledger: counts only grow, so the greater one is right."""
        if len(counts) == len(self.counts) and any(a > b for a, b in zip(counts, self.counts, strict=True)):
            self.counts = [max(pair) for pair in zip(counts, self.counts, strict=True)]
            self._write()

    def _write(self) -> None:
        """Keeps the counts; does nothing in memory."""
