"""The planner's silence, and what a lost planner had asked for: none of it begins any more."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.controller.program import Program
from tests.simulation.judge.account import Account
from tests.simulation.judge.verdict import require

TICK = 0.01  # [s], period of the executor's loop
LONGEST = 2 * TICK  # [s] that one period counts at most: a stall of the executor is no silence of the planner
LATE = 3 * TICK  # [s] within which the silence is noticed


class Silence:
    """Judges what becomes of a planner that is silent or gone.

    Args:
        lose: is called when a planner was silent for too long.
    """

    def __init__(self, account: Account, lose: Callable[[], None]) -> None:
        self._a, self._lose = account, lose
        self.begin()

    def begin(self) -> None:
        self.connected = self._lost = False
        self._silence, self._ticked = 0.0, self._a.now
        self._heard_epoch = self._barred = 0

    @property
    def due(self) -> bool:
        """Whether the executor may notice the silence now."""
        return self.connected and not self._lost and self._silence > self._a.arm.planner_timeout - LATE

    def hears(self) -> None:
        self._silence, self._lost, self._heard_epoch = 0.0, False, self._epoch

    def notice(self) -> None:
        self._lost, self._barred = True, max(self._barred, self._heard_epoch)

    def gone(self) -> None:
        self.connected, self._barred = False, max(self._barred, self._epoch)

    def tick(self) -> None:
        """A period begins: a silence may be too long."""
        a = self._a
        self._silence += min(a.now - self._ticked, LONGEST)
        self._ticked = a.now
        if self.connected and not self._lost and self._silence > a.arm.planner_timeout + LATE:
            self.notice()
            self._lose()

    def accepted(self, program: Program) -> None:
        """Judges the epoch of an accepted program."""
        a, text = self._a, f"program {program.program} of epoch {program.epoch} is accepted"
        require(program.epoch == self._epoch, f"{text} in epoch {self._epoch}")
        require(program.epoch > self._barred, f"{text}, and was planned before the loss of its planner")
        require(a.mode in ("ready", "executing"), f"{text} in mode {a.mode}")

    @property
    def _epoch(self) -> int:
        return 0 if self._a.shown is None else self._a.shown.epoch
