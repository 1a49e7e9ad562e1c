"""Statements on the executor's process and its buses: heartbeats, doors, ends, defects."""

from __future__ import annotations

from hyperbit.controller.executor.core.events import Event, FromClient
from hyperbit.controller.program import TICK, Cancel, Diagnostics, Stop, Up
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.executor.process import LOOP_FAILS
from tests.simulation.statements.account import Account
from tests.simulation.statements.arm import mask_of
from tests.simulation.statements.motions import Switch
from tests.simulation.statements.statement import Statement

LOOK_EVERY = 0.005  # [s] between two looks at the buses
DIAGNOSED = 1.3  # [s] between two diagnostics
MODES = {  # those that may follow
    "starting": ("ready", "fault", "stopped"),
    "ready": ("executing", "fault", "stopped", "starting"),
    "executing": ("ready", "fault", "stopped", "starting"),  # starting: a commissioner goes during a trial
    "fault": ("starting", "stopped"),
    "stopped": ("starting", "fault"),  # fault: the boot after a reset fails at once
}


class HeartbeatsDoNotPause(Statement):
    """The executor's heartbeats have no gap on each bus while its process is awake and the bus works."""

    number = 9

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._last: dict[str, float] = {}  # on each bus, when it was sent, or could not be [s]
        self._looks_at = 0.0

    def leaves(self, bus: str, frame: Frame, missing: int) -> None:
        if frame.id == cia301.HEARTBEAT + 127:
            self._last[bus] = self.account.now

    def steps(self) -> None:
        world, now = self.account.world, self.account.now
        if now < self._looks_at:
            return
        self._looks_at = now + LOOK_EVERY
        for name, bus in world.buses.items():
            if not bus.healthy or not world.executor.awake or bus.loss:
                self._last[name] = now
            gap = now - max(self._last.setdefault(name, now), world.executor.awake_since)
            self.require(gap <= world.arm.timing.heartbeat_timeout, f"{name}: no heartbeat for {gap:g} s")


class DiagnosticsCome(Statement):
    """An executor that is awake sends diagnostics to its planner once a second."""

    number = 9

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._last = 0.0

    def says(self, message: Up) -> None:
        if isinstance(message, Diagnostics):
            self._last = self.account.now

    def told(self, event: Event) -> None:
        account = self.account
        if account.planner is None or not account.clear:
            self._last = account.now
        else:
            self.require(account.now - self._last <= DIAGNOSED, f"no diagnostics for {DIAGNOSED:g} s")


class NothingBeginsBesideAnOpenDoor(Statement):
    """Nothing begins after an open interlock has reached the executor."""

    number = 1

    def switches(self, switch: Switch) -> None:
        account, sync = self.account, switch.sync
        if switch.cause == "SYNC" and sync is not None and account.world.arm.wiring.interlocks:
            begins = sync.commanded_at > account.doors.known_at + TICK
            self.require(not begins, f"{switch.mask:b} switch while a door is open")


class AnEndInOrderLeavesTheArmAtRest(Statement):
    """An executor that ends in order leaves no pulse on, and contracts the arm if `on_stop` says so."""

    number = 1

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._hurried = self._held = self._warned = False

    def started(self) -> None:
        self._hurried = self._held = self._warned = False

    def logs(self, level: int, text: str) -> None:
        self._warned |= "not contract" in text

    def hurries(self) -> None:
        self._hurried = True

    def told(self, event: Event) -> None:
        account = self.account
        if isinstance(event, FromClient) and isinstance(event.message, Stop | Cancel) and account.quitting:
            self._held |= event.client in account.roles
        elif not account.quitting:
            self._held = account.mode not in ("ready", "executing")

    def killed(self) -> None:
        account, pins = self.account, self.account.pins.now
        if not account.ordered_end or self._hurried:
            return
        if account.clear:
            on = pins.on & mask_of(account.arm.pulse)
            self.require(not on, f"the executor has ended, and the pulses of {on:b} are on")
        if account.arm.contracts_at_end and not self._held:
            left = pins.states & ~account.locked & ~account.homing & ~account.pins.missed & ~account.pins.fallen
            self.require(not left or self._warned, f"the executor has ended, and {left:b} are not contracted")


class ModesFollowOneAnother(Statement):
    """The executor's mode changes only as its page says."""

    number = 13

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._mode = "starting"

    def started(self) -> None:
        self._mode = "starting"

    def steps(self) -> None:
        core, before = self.account.world.executor.core, self._mode
        if core is not None and core.modes.mode != before:
            self._mode = core.modes.mode
            self.require(self._mode in MODES[before], f"the mode {before} becomes {self._mode}")


class NoDefect(Statement):
    """The executor catches no internal error, and its own invariants hold after each step."""

    number = 18

    def logs(self, level: int, text: str) -> None:
        defect = text.startswith("internal error") and LOOP_FAILS not in text
        self.require(not defect, text)
