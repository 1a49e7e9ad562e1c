"""Counts: the journal has each switch of the bus once, and all messages tell the journal's counts."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from hyperbit.controller.program import Diagnostics
from tests.simulation.judge.account import Account
from tests.simulation.judge.arm import bits_of, mask_of
from tests.simulation.judge.verdict import require
from tests.simulation.judge.waits import READ_BACK, TICK

HEARTBEAT, EMERGENCY = 0x700, 0x080
WAITED = 5  # periods of an open question of which one must be told as a wait
EVERY = 1.0 + 3 * TICK  # [s], longest time between two diagnostics


class Counts:
    """Judges counts of switches, and diagnostics.

    Attributes:
        connected: whether a planner was connected at the last tick.
    """

    def __init__(self, account: Account) -> None:
        self._a = account
        self._base: dict[int, int] = {}  # by actuator, count less switches of the bus
        self._switches = [0] * account.arm.count  # of the bus, as the journal must count them
        self._doubtful = 0  # mask of the actuators that a process has switched as it ended, perhaps not counted
        self._let_go = 0  # mask of those that it wanted to switch, and that their boards have contracted perhaps
        self._clear_since = 0.0  # since when the base holds
        self._told_at = 0.0
        self._health: tuple[dict[str, float], int] = {}, 0
        self._sent: Counter[str] = Counter()
        self._handed: Counter[str] = Counter()
        self._received: Counter[str] = Counter()
        self._beats: dict[tuple[str, int], float] = {}
        self._emergencies: set[tuple[str, int]] = set()  # boards that this process has heard an emergency of
        self._waits = self._open_ticks = 0
        self._counted_at = 0.0
        self.connected = False
        self._least: tuple[int, ...] = ()  # counts below which nothing may be told any more

    def begin(self, let_go: int = 0) -> None:
        """Forgets the last process. Its last switches are counted as far as the next boot can read them.

        Args:
            let_go: mask of the actuators that their boards contract without the executor.
        """
        self._told_at, self._health = self._a.now, ({}, 0)
        self._sent.clear()
        self._handed.clear()
        self._received.clear()
        self._beats.clear()
        self._emergencies.clear()
        self._waits = self._open_ticks = 0
        commit = self._a.commit
        if self._a.committing and commit is not None:
            self._doubtful |= commit.switched
            self._let_go |= commit.mask & ~commit.switched & let_go

    def switched(self, mask: int) -> None:
        """Takes the mask of the actuators that a SYNC has switched, as far as the executor can know."""
        for k in bits_of(mask):
            self._switches[k] += 1

    def raised(self, counts: tuple[int, ...]) -> None:
        """The planner tells the counts of its ledger: the greater ones are right."""
        a = self._a
        if len(counts) != a.arm.count:
            return
        least = self._least or (0,) * a.arm.count
        self._least = tuple(map(max, least, counts))
        for k, base in list(self._base.items()):
            self._base[k] = max(base, counts[k] - self._switches[k])

    def tick(self, connected: bool) -> None:
        """Finds missing diagnostics."""
        a, self.connected = self._a, connected
        self._open_ticks += a.run is not None and a.run.question is not None
        if not a.clear or not connected:
            self._told_at = a.now
        require(a.now - self._told_at <= EVERY, f"no diagnostics for {a.now - self._told_at:g} s")

    def process(self, loop: dict[str, float], dropped: int) -> None:
        self._health = loop, dropped

    def hands_out(self, bus: str) -> None:
        self._handed[bus] += 1

    def echoes(self, bus: str) -> None:
        self._sent[bus] += 1

    def hears(self, bus: str, cob_id: int) -> None:
        self._received[bus] += 1
        if cob_id & 0x780 == EMERGENCY:
            self._emergencies.add((bus, cob_id & 0x7F))
        if cob_id & 0x780 == HEARTBEAT:
            self._beats[bus, cob_id & 0x7F] = self._a.now

    def told(self, counts: Sequence[int]) -> None:
        """Judges counts in a message. Switches count when they were read back."""
        a = self._a
        low = [k for k, (count, least) in enumerate(zip(counts, self._least, strict=False)) if count < least]
        require(not low, f"counts {counts} are told after {self._least}")
        self._least = tuple(counts)
        if not a.clear or self._clear_since != a.clear_since:
            self._base, self._clear_since = {}, a.clear_since
            self._doubtful = self._let_go = 0
        if not a.clear or a.committing or a.ready_at == math.inf:
            return
        unsteady = mask_of(k for k, at in enumerate(a.ground.switched_at) if a.now <= at + READ_BACK)
        for k, (count, seen) in enumerate(zip(counts, self._switches, strict=True)):
            steady = not unsteady >> k & 1
            if not steady and k not in self._base:
                continue
            before = self._base.setdefault(k, count - seen)
            missing = seen + before - count
            text = f"actuator {k}: {count} switches are told, the bus had {seen + before}"
            few, many = self._doubtful >> k & 1 or not steady, self._let_go >> k & 1
            require(missing == 0 or (missing == 1 and few) or (missing == -1 and many), text)
            if steady:
                self._base[k] = count - seen
        self._doubtful &= unsteady
        self._let_go &= unsteady

    @property
    def counted_now(self) -> bool:
        return self._counted_at == self._a.now

    def ends(self) -> None:
        """The process has ended in order: the planner knows the last counts."""
        planner = self.connected
        require(not planner or self.counted_now, "the executor has ended, and has not told its counts")

    def counted(self, counts: Sequence[int]) -> None:
        """Judges the message that tells counts before a result, and at the end."""
        self._counted_at = self._a.now
        self.told(counts)

    def diagnosed(self, message: Diagnostics) -> None:
        a = self._a
        self.told(message.counts)
        self._told_at = a.now
        grown, self._waits = message.waits - self._waits, message.waits
        asked, self._open_ticks = self._open_ticks, 0
        require(grown >= 0 and (grown or asked <= WAITED), f"waits grow by {grown} in {asked} periods of a question")
        told = dict(message.loop), message.dropped
        require(told == self._health, f"loop and dropped messages are told as {told}, the process says {self._health}")
        if not a.clear or a.mode not in ("ready", "executing") or a.now < a.ready_at + 0.2:
            return
        for bus in message.buses:
            require(bus["state"] in ("active", "warning"), f"{bus['name']} is told as {bus['state']}")
            name = str(bus["name"])
            sent, heard = int(str(bus["tx_frames"])), int(str(bus["rx_frames"]))
            least, most = self._sent[name], self._handed[name]  # some are on their way
            require(least <= sent <= most, f"{name}: {sent} frames are told as sent; {least} were, {most} handed out")
            require(
                heard == self._received[name], f"{name}: {heard} frames are told, heard were {self._received[name]}"
            )
        oldest = 2 * a.arm.timing.heartbeat + 0.05
        for board in message.boards:
            require(board["state"] == "operational", f"{board} is operational")
            age = board["heartbeat_age"]
            require(isinstance(age, float) and 0 <= age <= oldest, f"{board}: its heartbeat is younger")
            heard = a.now - self._beats.get((str(board["bus"]), int(str(board["node"]))), 0.0)
            require(abs(age - heard) <= 2 * TICK, f"{board}: its heartbeat was heard {heard:g} s ago")
            sent = (str(board["bus"]), int(str(board["node"]))) in self._emergencies
            require(sent or board["emergency"] is None, f"{board}: no emergency stands")
