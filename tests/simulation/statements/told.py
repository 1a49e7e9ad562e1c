"""Statements on what the executor tells: snapshots, counts, numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hyperbit.controller.executor.core.events import ClientGone, Event, FromClient
from hyperbit.controller.program import (
    Accepted,
    Begun,
    Cancel,
    Counted,
    Diagnostics,
    Ended,
    Settled,
    Snapshot,
    Stop,
    Up,
    Welcome,
    unpack,
)
from tests.simulation.statements.account import Account
from tests.simulation.statements.arm import bits_of, mask_of
from tests.simulation.statements.motions import EPSILON, Energised, Switch
from tests.simulation.statements.statement import Statement

LATE = 0.1  # [s] that a snapshot may be late


class SnapshotsAreTrue(Statement):
    """What a snapshot calls known was true at a time of the last 0.1 s; what has switched since the boot moves."""

    number = 5

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._booted_at = -math.inf

    def steps(self) -> None:
        if self.account.mode == "starting":  # also before anybody is connected
            self._booted_at = self.account.now

    def says(self, message: Up) -> None:
        account = self.account
        if not isinstance(message, Snapshot) or message.mode not in ("ready", "executing") or not account.clear:
            return
        measured, known, arm = unpack(message.measured), unpack(message.known), account.arm
        locked = account.locked | unpack(message.locked)
        known &= ~(locked | account.pins.missed) | arm.sensed
        ever, always = 0, -1
        for pins in account.pins.since(account.now - LATE):
            read = arm.measured(pins.extended, pins.contracted, pins.states)
            ever, always = ever | read, always & read
        wrong = known & (measured & ~ever | ~measured & always)
        self.require(not wrong, lambda: f"{measured:b} is told of {known:b}, {wrong:b} is wrong")
        driven, ever, always = unpack(message.outputs), 0, -1
        for pins in account.pins.since(account.now - LATE):
            ever, always = ever | pins.states, always & pins.states
        unsure = account.homing | unpack(message.homing) | locked | account.pins.missed
        wrong = (driven & ~ever | ~driven & always) & ~unsure
        self.require(not wrong, lambda: f"the outputs {driven:b} are told, {wrong:b} is wrong")
        travels = self._travelling(account.now)
        self.require(message.moving or not travels, lambda: f"{travels:b} travel, and nothing is told as moving")
        due = max(
            (account.pins.due(k) for k in range(arm.count) if account.pins.switched_at[k] < account.now - LATE),
            default=0,
        )
        free = message.free_at >= due - EPSILON or due <= account.now  # outputs fall unnoticed if boards are lost
        self.require(free, lambda: f"free_at {message.free_at - due:g} s too early")

    def _travelling(self, now: float) -> int:
        """Returns the mask of the actuators that were switched a while ago, and that nobody may call arrived."""
        account, mask = self.account, 0
        for k, at in enumerate(account.pins.switched_at):
            if (
                self._booted_at < at < now - LATE / 2
                and now < account.pins.due(k) - EPSILON
                and not account.pins.arrived >> k & 1
            ):
                mask |= 1 << k
        return mask


class SilentBoardsAreUnknown(Statement):
    """States of a board that is silent or without supply are not known, as soon as its silence is a loss."""

    number = 5

    def says(self, message: Up) -> None:
        account, timing = self.account, self.account.arm.timing
        if not isinstance(message, Snapshot) or message.mode == "starting":
            return
        longest = 1.2 * timing.heartbeat_timeout + timing.heartbeat + LATE
        quiet = min(account.now - account.world.executor.awake_since, account.now - account.instance_at)
        if quiet < longest:
            return
        for board, at in account.heard_at.items():
            if account.now - at > longest:
                told = unpack(message.known) & account.world.boards.names.get(board, 0)
                self.require(not told, f"{told:b} of {board} is known, not heard for {account.now - at:g} s")


class CountsAreTheSwitches(Statement):
    """Journal and counts are the pins' changes by SYNC, up to what is open, also over kills."""

    number = 6

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._before: list[int] = []
        self._switched = False  # since the last comparison

    def says(self, message: Up) -> None:
        if isinstance(message, Counted | Diagnostics | Welcome):
            self._compare(message.counts, "told")

    def switches(self, switch: Switch) -> None:
        self._switched = True

    def steps(self) -> None:
        counts = self.account.world.executor.journal.counts
        if self._switched or counts != self._before:
            self._before, self._switched = list(counts), False
            self._compare(counts, "the journal has")

    def _compare(self, counts: Sequence[int], whose: str) -> None:
        record, intended = self.account.world.record, self.account.world.intended
        for k, (counted, synced, slack) in enumerate(zip(counts, record.synced, record.slack, strict=True)):
            least, most = synced - slack - (intended >> k & 1), synced + slack
            self.require(least <= counted <= most, f"actuator {k} switched {synced} times, {whose} {counted}")


class ResultsCountTheirSwitches(Statement):
    """A result, or a settled mark, tells the switches of its program; of travels it tells at most as many."""

    number = 6

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._least: dict[int, list[int]] = {}  # by program, switches of each actuator
        self._again: dict[int, int] = {}  # by program, pulses that may have switched nothing
        self._carried: dict[int, int] = {}  # by program, mask of the actuators that travelled at its begin

    def started(self) -> None:
        self._least, self._again, self._carried = {}, {}, {}

    def switches(self, switch: Switch) -> None:
        if switch.cause == "SYNC" and switch.sync is not None and switch.sync.program is not None:
            counts = self._least.setdefault(switch.sync.program, [0] * self.account.arm.count)
            for k in bits_of(switch.mask):
                counts[k] += 1

    def energises(self, coils: Energised) -> None:
        if coils.cause == "SYNC" and coils.sync is not None and coils.sync.program is not None:
            number = coils.sync.program
            self._again[number] = self._again.get(number, 0) + coils.again.bit_count()

    def says(self, message: Up) -> None:
        account = self.account
        if isinstance(message, Accepted):
            late = (k for k, margin in enumerate(account.arm.margin) if account.now < account.pins.due(k) + margin)
            self._carried[message.program] = mask_of(late)
        if not isinstance(message, Ended | Settled) or account.pins.missed or account.pins.fallen:
            return
        counts = self._least.get(message.program, [0] * account.arm.count)
        least, carried = sum(counts), self._carried[message.program]
        most = least + self._again.get(message.program, 0)
        right = least <= message.switches <= most or not account.clear
        self.require(right, f"{message.switches} switches of program {message.program} are told, it made {least}")
        if isinstance(message, Ended):
            told = [travel.actuator for travel in message.travels]
            many = [k for k in set(told) if told.count(k) > counts[k] + (carried >> k & 1) + (most > least)]
            self.require(not many, f"travels of {many} are told too often")


class NumbersNeverFall(Statement):
    """Epochs, numbers and times never fall; stages and marks of a program are told once, in their order."""

    number = 13

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._last: dict[object, float] = {}

    def started(self) -> None:
        self._last = {}

    def says(self, message: Up) -> None:
        match message:
            case Snapshot():
                self._grows("snapshot", message.at, strictly=False)
                self._grows("epoch", message.epoch, strictly=False)
            case Begun():
                self._grows(("stage", message.program), message.stage)
                self._grows(("switches", message.program), message.switches, strictly=False)
            case Settled():
                motion = self.account.programs[message.program]
                right = motion.unsettled and motion.stages[motion.taken].mark == message.mark
                self.require(
                    right, f"mark {message.mark} of program {message.program} is told, at stage {motion.taken}"
                )
            case Ended() if message.result not in self.account.owed:
                self._grows("result", message.result)

    def _grows(self, name: object, value: float, strictly: bool = True) -> None:
        last = self._last.get(name)
        self._last[name] = value
        grows = last is None or value > last or (value == last and not strictly)
        self.require(grows, f"{name} was {last}, and is {value}")


class EpochsEnd(Statement):
    """A stop, a cancel and the loss of the planner begin an epoch: what was planned before cannot begin later."""

    number = 13

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._ended = -1

    def started(self) -> None:
        self._ended = -1

    def told(self, event: Event) -> None:
        account = self.account
        match event:
            case FromClient(client, Stop()) if client in account.roles:
                self._ended = account.epoch
            case FromClient(client, Cancel(program=None)) if client == account.planner:
                self._ended = account.epoch
            case ClientGone(client) if client == account.planner:
                self._ended = account.epoch

    def says(self, message: Up) -> None:
        if isinstance(message, Snapshot) and self._ended >= 0:
            self.require(message.epoch > self._ended, f"epoch {message.epoch} goes on after epoch {self._ended} ended")
            self._ended = -1
