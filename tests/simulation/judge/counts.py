"""Counts: the journal has each switch of the bus once, and all messages tell the journal's counts."""

from __future__ import annotations

from collections.abc import Sequence

from controller.program import Diagnostics
from tests.simulation.judge.account import Account
from tests.simulation.judge.programs import READ_BACK, TICK
from tests.simulation.judge.verdict import require

EVERY = 1.0 + 3 * TICK  # [s], longest time between two diagnostics


class Counts:
    """Judges counts of switches, and diagnostics.

    Args:
        account: of the executor.
    """

    def __init__(self, account: Account) -> None:
        self._a = account
        self._base: tuple[float, list[int]] | None = None  # clear since, and count less switches of the bus
        self._told_at = 0.0

    def begin(self) -> None:
        """Forgets the last process. Nobody can tell whether a pulse of its last commit has switched."""
        if self._a.committing:
            self._base = None
        self._told_at = self._a.now

    def told(self, counts: Sequence[int]) -> None:
        """Judges counts in a message."""
        a = self._a
        if not a.clear or a.homing:
            self._base = None
            return
        settled = not a.committing and (a.mover is None or a.now > a.mover.at + READ_BACK)
        offsets = [told - seen for told, seen in zip(counts, a.ground.counts, strict=True)]
        if self._base is None or self._base[0] != a.clear_since:
            self._base = (a.clear_since, offsets) if settled else None
            return
        for k, (now, before) in enumerate(zip(offsets, self._base[1], strict=True)):
            text = (
                f"actuator {k}: {counts[k]} switches are told, the bus had {now - before} fewer since it was compared"
            )
            require(now == before or (not settled and now == before - 1), text)

    def diagnosed(self, message: Diagnostics, connected: bool) -> None:
        """Judges diagnostics."""
        a = self._a
        self.told(message.counts)
        if a.clear and connected and self._told_at > a.clear_since:
            late = a.now - self._told_at
            require(late <= EVERY, f"diagnostics come after {late:g} s")
        self._told_at = a.now
        if not a.clear or a.mode not in ("ready", "executing") or a.now < a.ready_at + 0.2:
            return
        for bus in message.buses:
            require(bus["state"] in ("active", "warning"), f"{bus['name']} is told as {bus['state']}")
            require(bus["tx_frames"] and bus["rx_frames"], f"no frames are told: {bus}")
        oldest = 2 * a.arm.timing.heartbeat + 0.05
        for board in message.boards:
            require(board["state"] == "operational", f"{board} is operational")
            age = board["heartbeat_age"]
            require(isinstance(age, float) and 0 <= age <= oldest, f"{board}: its heartbeat is younger")
