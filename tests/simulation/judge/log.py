"""The log and the status for systemd: each mode and each fault once, in the words of the snapshots."""

from __future__ import annotations

import logging
from collections import Counter

from hyperbit.controller.program import Snapshot
from tests.simulation.judge.account import Account
from tests.simulation.judge.verdict import require

STANDING = frozenset({"degraded", "unknown-position"})
WARNED = frozenset({"fault", "stopped"})  # modes that are warnings in the log
MARGIN = 10.0  # [s] that systemd waits longer than a contraction takes
MOST = 300  # characters of a fault's message in a snapshot


class Log:
    """Judges lines of the log by the snapshots that follow.

    Attributes:
        simulated: whether the status tells that the boards are simulated.
        watchdog: systemd's watchdog time [s]; None without a watchdog.

    Args:
        lets_go: mask of the actuators that the boards contract without the executor.
    """

    def __init__(self, account: Account, lets_go: int) -> None:
        self.simulated = False
        self.watchdog: float | None = None
        self._a, self._lets_go = account, lets_go
        self.begin()

    def begin(self) -> None:
        self._status: str | None = None
        self._warned = False  # of what the boards do after the end
        self._told: Counter[str] = Counter()  # of the faults since the last boot
        self._modes: list[str] = []  # lines of modes since the last snapshot
        self._beat_at = self._a.now
        self._notified: set[str] = set()

    def notifies(self, text: str) -> None:
        if text.startswith("STATUS="):
            self._status = text.removeprefix("STATUS=")
            return
        require(text not in self._notified or text == "WATCHDOG=1", f"systemd is told {text} twice")
        self._notified.add(text)
        if text == "WATCHDOG=1":
            require(self.watchdog is not None, "systemd's watchdog gets a beat, and there is none")
            self._beat_at = self._a.now
        elif text.startswith("EXTEND_TIMEOUT_USEC="):
            least = self._a.arm.ending
            told = int(text.split("=")[1]) / 1e6
            require(least < told <= least + MARGIN, f"systemd is to wait {told:g} s, the contraction takes {least:g} s")
        else:
            require(text in ("READY=1", "STOPPING=1"), f"systemd is told {text}")

    def tick(self) -> None:
        """Finds missing beats of the watchdog."""
        a = self._a
        if self.watchdog is None or not a.clear:
            self._beat_at = a.now
            return
        gap = a.now - self._beat_at
        require(gap <= self.watchdog / 2, f"systemd's watchdog of {self.watchdog:g} s gets no beat for {gap:g} s")

    def ticked(self) -> None:
        """The first period has ended: systemd knows that the process is ready."""
        require("READY=1" in self._notified, "systemd is not told READY=1 at the first tick")

    def quits(self, contracts: bool) -> None:
        """The process was asked to end, and has handled it."""
        require("STOPPING=1" in self._notified, "systemd is not told STOPPING=1")
        longer = any(text.startswith("EXTEND") for text in self._notified)
        require(
            longer == contracts, f"systemd is told that the end takes longer: {longer}; the arm contracts: {contracts}"
        )

    def logs(self, level: int, text: str) -> None:
        mode = text.split(":")[0]
        if mode in ("starting", "ready", "executing", "fault", "stopped"):
            right = logging.WARNING if mode in WARNED else logging.INFO
            require(level == right, f"the line {text!r} has level {level}")
            require(not self._modes or self._modes[-1] != text, f"the line {text!r} is written twice")
            if mode == "starting":
                self._told.clear()
            self._modes.append(text)
            self._a.told = mode
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
        self._a.told = snapshot.mode
        if last is not None and (last.mode, last.reason) != (snapshot.mode, snapshot.reason):
            require(shown in lines, f"the log does not tell {shown!r}, only {lines}")
        if self._status is not None:
            shown = shown.replace(":", " (simulated):", 1) if self.simulated else shown
            require(self._status == shown, f"the status is {self._status!r}, shown is {shown!r}")
