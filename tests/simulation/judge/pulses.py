"""Pulses: as long as the arm's file says, in a world without disturbances."""

from __future__ import annotations

from tests.simulation.judge.account import Account
from tests.simulation.judge.arm import bits_of
from tests.simulation.judge.verdict import require

SHORTER = 0.01  # [s] that a pulse may be too short: it ends at a tick, and its first SYNC may wait for other frames
LONGER = 0.02  # [s] that it may be too long: to the next tick, and a commit that is under way


class Pulses:
    """Judges how long the outputs of pairs are on.

    Args:
        account: of the executor.
    """

    def __init__(self, account: Account) -> None:
        self._a = account
        self._since: dict[int, float] = {}

    def energises(self, on: int, came: int, cause: str) -> None:
        """Takes the mask of the actuators with an output on, and of those whose output has just come on."""
        a = self._a
        for k in [k for k in self._since if not on >> k & 1 or came >> k & 1]:
            since = self._since.pop(k)
            if k not in a.arm.pulse or not a.clear or since < a.clear_since:
                continue
            length = a.now - since
            reversed_ = on >> k & 1  # by a later stage
            require(
                reversed_ or length >= a.arm.pulse[k] - SHORTER, f"actuator {k}: a pulse of {length:g} s, by {cause}"
            )
            require(length <= a.arm.pulse[k] + LONGER, f"actuator {k}: a pulse of {length:g} s, by {cause}")
        for k in bits_of(came):
            self._since[k] = a.now
