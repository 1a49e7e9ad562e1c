"""The sentence on the mode: it tells what runs, or what ended it, as long as the mode lasts."""

from __future__ import annotations

from hyperbit.controller.program import Setpoint, Snapshot
from tests.simulation.judge.account import Account
from tests.simulation.judge.verdict import require

HELD = "holding what the boards measured"


class Reasons:
    """Judges the reasons in the snapshots of one executor."""

    def __init__(self, account: Account) -> None:
        self._a = account
        self.begin()

    def begin(self) -> None:
        self._words: tuple[str, ...] | None = None  # of the present mode; None: not known
        self._followed: Setpoint | None = None

    def holds(self, *words: str) -> None:
        """Something ends what runs; the reason has these words if anything ran."""
        if self._a.run is not None or self._a.stream is not None:
            self._words, self._followed = words, None

    def enters(self, *words: str) -> None:
        """Something happens of which the reason has these words."""
        self._words = words
        self._followed = None

    def follows(self, message: Setpoint) -> None:
        self._followed, self._words = message, None

    def shows(self, last: Snapshot | None, snapshot: Snapshot) -> None:
        a, reason, mode = self._a, snapshot.reason, snapshot.mode
        if a.ready_at == a.now:
            self._words = (HELD,)
        if not a.clear or mode not in ("ready", "executing", "stopped") or a.quitting:
            self._words = None if not a.clear else self._words
            return
        if mode == "executing" and a.run is not None:
            require(reason == a.run.message.name, f"the reason is {reason!r}, program {a.run.message.name!r} runs")
        elif mode == "executing" and a.stream is not None and self._followed is not None:
            require(reason == self._followed.reason, f"the reason is {reason!r}, followed is {self._followed.reason!r}")
        elif mode != "executing" and self._words is not None:
            missing = [word for word in self._words if word not in reason]
            require(not missing, f"the reason is {reason!r}, and does not tell {missing}")
        if mode == "ready" and HELD in reason:
            locked = f"locked: {', '.join(self._locked())}" if a.locked else ""
            require(reason.endswith(locked) and ("locked" in reason) == bool(a.locked), f"{reason!r}; it is {locked!r}")

    def _locked(self) -> list[str]:
        a, words = self._a, ("contracted", "extended")
        return [
            f"{a.arm.labels[k]} ({words[a.locked_states >> k & 1]})" for k in range(a.arm.count) if a.locked >> k & 1
        ]
