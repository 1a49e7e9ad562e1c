"""The log and the status for systemd: each mode and each fault once, in the words of the snapshots."""

from __future__ import annotations

import logging
from collections import Counter

from controller.program import Snapshot
from tests.simulation.judge.account import Account
from tests.simulation.judge.verdict import require

STANDING = frozenset({"degraded", "unknown-position"})
WARNED = frozenset({"fault", "stopped"})  # modes that are warnings in the log
MOST = 300  # characters of a fault's message in a snapshot


class Log:
    """Judges lines of the log by the snapshots that follow.

    Args:
        account: of the executor.
        lets_go: mask of the actuators that the boards contract without the executor.
    """

    def __init__(self, account: Account, lets_go: int) -> None:
        self._a, self._lets_go = account, lets_go
        self.begin()

    def begin(self) -> None:
        """Forgets the last process."""
        self._status: str | None = None
        self._warned = False  # of what the boards do after the end
        self._told: Counter[str] = Counter()  # of the faults since the last boot
        self._modes: list[str] = []  # lines of modes since the last snapshot

    def notifies(self, text: str) -> None:
        """Takes a message for systemd."""
        if text.startswith("STATUS="):
            self._status = text.removeprefix("STATUS=")

    def logs(self, level: int, text: str) -> None:
        """Takes a line."""
        mode = text.split(":")[0]
        if mode in ("starting", "ready", "executing", "fault", "stopped"):
            right = logging.WARNING if mode in WARNED else logging.INFO
            require(level == right, f"the line {text!r} has level {level}")
            require(not self._modes or self._modes[-1] != text, f"the line {text!r} is written twice")
            if mode == "starting":
                self._told.clear()
            self._modes.append(text)
        elif text.startswith("when the executor has ended"):
            self._warned = True
            require(f"contract {self._words()}" in text, f"the line {text!r}; it is {self._words()}")
        elif level >= logging.ERROR:
            self._told[text[:MOST]] += 1
            require(self._told[text[:MOST]] == 1, f"the line {text!r} is written {self._told[text[:MOST]]} times")

    def _words(self) -> str:
        count = self._lets_go.bit_count()
        return f"all {count} actuators" if count == self._a.arm.count else f"{count} actuators"

    def shows(self, last: Snapshot | None, snapshot: Snapshot) -> None:
        """Judges the lines by a snapshot."""
        shown = f"{snapshot.mode}: {snapshot.reason}"
        warned = bool(self._lets_go) and not self._a.arm.contracts_at_end
        require(
            warned == self._warned, f"{self._lets_go:b} contract without the executor, the log tells: {self._warned}"
        )
        lines, self._modes = self._modes, []
        if last is not None and (last.mode, last.reason) != (snapshot.mode, snapshot.reason):
            require(shown in lines, f"the log does not tell {shown!r}, only {lines}")
        if self._status is not None:
            require(self._status == shown, f"the status is {self._status!r}, shown is {shown!r}")
