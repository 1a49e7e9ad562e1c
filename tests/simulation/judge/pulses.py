"""Pulses: as long as the arm's file says, and told where they are overdue."""

from __future__ import annotations

import math

from hyperbit.controller.program import Snapshot
from tests.simulation.judge.account import Account
from tests.simulation.judge.arm import bits_of
from tests.simulation.judge.verdict import require

SHORTER = 0.01  # [s] that a pulse may be too short: it ends at a tick, and its first SYNC may wait for other frames
LONGER = 0.02  # [s] that it may be too long: to the next tick, and a commit that is under way
TOLD_IN = ("ready", "executing", "fault", "stopped")  # modes
OVERDUE = 0.1  # [s] after its end at which a pulse must be told as overdue
TICKS = 4  # periods of an executor that is awake, within which it is told


class Pulses:
    """Judges how long the outputs of pairs are on.

    Attributes:
        suspect: mask of the actuators whose boards have missed a frame since their boot.
    """

    def __init__(self, account: Account) -> None:
        self.suspect = 0
        self._a = account
        self._since: dict[int, float] = {}  # when an output came on
        self._died_at = 0.0  # the boards switch off the pulses of a process that has ended
        self._overdue: dict[int, int] = {}  # periods since each pulse is overdue

    def dies(self) -> None:
        self._died_at = self._a.now

    def boots(self) -> None:
        """A boot begins, which may fail at once: what is overdue is told anew."""
        self._overdue = dict.fromkeys(self._overdue, 0)

    def ticks(self) -> None:
        """A period begins: pulses may be overdue. Boots look for them when they have ended."""
        a = self._a
        for k, since in self._since.items():
            knows = since > self._died_at or a.ready_at < math.inf  # a process learns of others by its first boot
            late = knows and k in a.arm.pulse and a.now - since > a.arm.pulse[k] + OVERDUE and a.mode in TOLD_IN
            self._overdue[k] = self._overdue[k] + 1 if late and not self.suspect >> k & 1 else 0

    def shows(self, snapshot: Snapshot) -> None:
        """Requires that overdue pulses are told."""
        if snapshot.mode not in TOLD_IN:
            return
        for k, ticks in self._overdue.items():
            if k in self._since and ticks > TICKS:
                label = self._a.arm.labels[k]
                told = any(f.code == "pulse-overdue" and label in f.source for f in snapshot.faults)
                require(told, f"actuator {k}: a pulse is overdue for {ticks} periods, and {snapshot.faults} are told")

    def energises(self, on: int, came: int, cause: str) -> None:
        """Takes the mask of the actuators with an output on, and of those whose output has just come on."""
        a = self._a
        for k in [k for k in self._since if not on >> k & 1 or came >> k & 1]:
            since = self._since.pop(k)
            if k not in a.arm.pulse or not a.clear or since < max(a.clear_since, self._died_at):
                continue
            length = a.now - since
            reversed_ = on >> k & 1  # by a later stage
            require(
                reversed_ or length >= a.arm.pulse[k] - SHORTER, f"actuator {k}: a pulse of {length:g} s, by {cause}"
            )
            require(length <= a.arm.pulse[k] + LONGER, f"actuator {k}: a pulse of {length:g} s, by {cause}")
        for k in bits_of(came):
            self._since[k], self._overdue[k] = a.now, 0
